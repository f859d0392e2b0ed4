"""Force regression under domain shift: networks, adaptation methods, training and evaluation."""

from typing import Any

import lazy_loader

from gelgap.assets.names import LAST_VERSION

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "register":
        # Of an AttributeError, `from … import …` would drop the sentence.
        raise ImportError(
            f"gelgap.adapt.register has left: gelgap {LAST_VERSION} is the last version that has it; name a method of "
            "your own with its file, FILE.py:CLASS"
        )
    return _attribute(name)
