"""The light: what the camera inside the sensor sees of a deformed membrane."""

import lazy_loader

from gelgap.assets.moved_names import answering_moved

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
_MOVED = (
    "detect_markers",
    "inpaint_telea",
)
__getattr__ = answering_moved(_attribute, __name__, "gelgap.data", _MOVED, since="0.4.0")
