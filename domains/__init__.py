"""Labelled domains: what a domain is, how it is drawn and generated."""

import lazy_loader

from gelgap.assets.moved_names import answering_moved

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
_MOVED = (
    "ArrayFrames",
    "LabelledFrames",
    "Labels",
    "convert",
    "export",
    "join_domains",
    "open_domain",
    "paired_contacts",
    "split_domains",
    "split_frames",
    "to_skada",
    "verify_domain",
    "with_labels",
)
__getattr__ = answering_moved(_attribute, __name__, "gelgap.data", _MOVED, since="0.4.0")
