"""Code that a user names as `FILE.py:NAME`: how it is run, and feature extractors of one's own.

Code runs only when the user names its file. A checkpoint keeps the name of its feature extractor, which runs nothing.
"""

import inspect
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from gelgap.assets.checksums import file_sha256, sha256
from gelgap.assets.names import left, unknown_name

if TYPE_CHECKING:
    from torch import nn

RESNETS = ("resnet18", "resnet50")
"""Feature extractors of gelgap's own."""
_BACKBONES: "dict[str, tuple[Callable[[int], nn.Module], str]]" = {}
"""Functions that make a user's feature extractor, by file and function, each with the hash of its code."""
LOG = logging.getLogger(__name__)
_FORM = "FILE.py:FUNCTION"


class CodeNotLoaded(ValueError):
    """The code of a feature extractor is needed, and the user has not named its file."""


def use_backbone(name: str) -> str:
    """Return what `Profile.backbone` calls a feature extractor: resnet18, resnet50 or `FILE.py:FUNCTION`.

    The file is run. Its function takes the number of channels of the network's input and returns a `torch.nn.Module`
    that maps pictures (n, channels, h, w) to features (n, d), or to maps (n, d, h', w'), which are averaged. The name
    that is returned has no folder, and a hash of the code, so that results of changed code are not taken for the same.

    Raises
    ------
    ValueError
        If there is no such feature extractor, or the file cannot be run or has no such function.
    """
    if name in RESNETS:
        return name
    if ":" not in name:
        raise ValueError(unknown_name("backbone", name, (*RESNETS, _FORM)))
    module, function = defined_in(name, "backbone", _FORM)
    make = getattr(module, function, None)
    if not callable(make):
        raise ValueError(f"backbone {name!r}: {function or 'nothing'} is not a function of {module.__file__}")
    file_and_function = f"{Path(name.rpartition(':')[0]).name}:{function}"
    code = code_sha256(make)[:12]
    _BACKBONES[file_and_function] = make, code
    return f"{file_and_function}#{code}"


def own_backbone(name: str) -> "Callable[[int], nn.Module]":
    """Return the function that `use_backbone` has loaded for a name.

    Raises
    ------
    CodeNotLoaded
        If it has not.
    """
    file_and_function, _, code = name.partition("#")
    if file_and_function not in _BACKBONES:
        raise CodeNotLoaded(
            f"the network has the feature extractor {file_and_function}, whose code is not loaded: name its file, as "
            f"--backbone {file_and_function}, or in Python use_backbone({file_and_function!r})"
        )
    make, loaded = _BACKBONES[file_and_function]
    if code != loaded:
        told = "the code of feature extractor %s is not that with which the network was trained"
        LOG.warning(told, file_and_function)
    return make


def code_sha256(item: Any) -> str:
    """Return the hash of the file that a class or function stands in; nothing where it has none, as in a notebook."""
    try:
        file = inspect.getsourcefile(item)
    except (TypeError, OSError):
        return ""
    return file_sha256(Path(file)) if file else ""


def defined_in(place: str, what: str, form: str) -> tuple[ModuleType, str]:
    """Return the module of `FILE.py:NAME`, and the name; this runs the file.

    Raises
    ------
    ValueError
        If it has another form or cannot be run; the sentence says `what` it was named as.
    """
    file, _, name = place.rpartition(":")
    if not file.endswith(".py"):
        raise ValueError(left(f"{what} of the form module:name,", place, f"name its file, {form}"))
    try:
        return _run(Path(file).resolve(strict=True)), name
    except Exception as error:
        is_missing = isinstance(error, ModuleNotFoundError)
        alone = "; files beside it are not found, as its hash is that of all its code" if is_missing else ""
        raise ValueError(
            f"{what} {place!r}: {file} could not be run ({type(error).__name__}: {error}); "
            f"name a .py file, and what it defines{alone}"
        ) from error


def _run(path: Path) -> ModuleType:
    # What it defines is found by its module's name when its source is asked for. A file that has changed is run again,
    # and not as Python has compiled it within the same second: else old code would go by the new one's hash.
    code = path.read_bytes()
    known_as = f"gelgap_own_{sha256(str(path).encode() + code)[:12]}"
    if known_as not in sys.modules:
        module = ModuleType(known_as)
        module.__file__ = str(path)
        sys.modules[known_as] = module
        try:
            exec(compile(code, path, "exec"), vars(module))
        except BaseException:
            del sys.modules[known_as]
            raise
    return sys.modules[known_as]
