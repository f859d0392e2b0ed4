"""The light: what the camera inside the sensor sees of a deformed membrane."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
