"""The page in the browser: a live model of one press, shown with viser, and what can be saved from it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
