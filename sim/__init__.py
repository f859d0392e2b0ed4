"""The gel: elastomers, indenters, contact paths and the solves that press one into the other."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
