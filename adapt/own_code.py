"""Code that a user names: `module:Name` or `file.py:Name`, and own feature extractors.

Code runs only when the user names its file. A checkpoint keeps the name of its feature extractor, which runs nothing.
"""

import inspect
import logging
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from gelgap.assets.checksums import file_sha256, sha256
from gelgap.assets.names import unknown_name

if TYPE_CHECKING:
    from torch import nn

RESNETS = ("resnet18", "resnet50")
"""Feature extractors of gelgap's own."""
_BACKBONES: "dict[str, tuple[Callable[[int], nn.Module], str]]" = {}
"""Functions that make a user's feature extractor, by file and function, each with the hash of its code."""
LOG = logging.getLogger(__name__)


class CodeNotLoaded(ValueError):
    """The code of a feature extractor is needed, and the user has not named its file."""


def use_backbone(name: str) -> str:
    """Return what `Profile.backbone` calls a feature extractor: resnet18, resnet50 or `file.py:make_backbone`.

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
        raise ValueError(unknown_name("backbone", name, (*RESNETS, "file.py:make_backbone")))
    module, function = imported(name, "backbone")
    make = getattr(module, function, None)
    if not callable(make):
        raise ValueError(f"backbone {name!r}: {function or 'nothing'} is not a function of {module.__file__}")
    own, code = f"{Path(name.rpartition(':')[0]).name}:{function}", code_sha256(make)[:12]
    _BACKBONES[own] = make, code
    return f"{own}#{code}"


def own_backbone(name: str) -> "Callable[[int], nn.Module]":
    """Return the function that `use_backbone` has loaded for a name.

    Raises
    ------
    CodeNotLoaded
        If it has not.
    """
    own, _, code = name.partition("#")
    if own not in _BACKBONES:
        raise CodeNotLoaded(
            f"the network has the feature extractor {own}, whose code is not loaded: name its file, as "
            f"--backbone {own}, or in Python use_backbone({own!r})"
        )
    make, loaded = _BACKBONES[own]
    if code != loaded:
        LOG.warning("the code of feature extractor %s is not that with which the network was trained", own)
    return make


def code_sha256(item: Any) -> str:
    """Return the hash of the file that a class or function stands in; nothing where it has none."""
    file = inspect.getsourcefile(item)
    return file_sha256(Path(file)) if file else ""


def imported(place: str, what: str) -> tuple[ModuleType, str]:
    """Return the module of `module:Name` or `file.py:Name`, and the name; this runs the module's code.

    Raises
    ------
    ValueError
        If it cannot be imported; the sentence says `what` it was named as.
    """
    module_name, _, name = place.rpartition(":")
    try:
        module = _from_file(module_name) if module_name.endswith(".py") else import_module(module_name)
    except Exception as error:
        is_missing = isinstance(error, ModuleNotFoundError)
        alone = "; files beside it are not found, as its hash is that of all its code" if is_missing else ""
        raise ValueError(
            f"{what} {place!r}: {module_name} could not be imported ({type(error).__name__}: {error}); "
            f"name a module or a .py file, and what it defines{alone}"
        ) from error
    return module, name


def _from_file(name: str) -> ModuleType:
    path = Path(name).resolve(strict=True)
    # What it defines is found by its module's name when its source is asked for. A file that has changed is run again,
    # and not as Python has compiled it within the same second: else old code would go by the new one's hash.
    code = path.read_bytes()
    known_as = f"gelgap_own_{sha256(str(path).encode() + code)[:12]}"
    if known_as not in sys.modules:
        spec = spec_from_file_location(known_as, path)
        module = sys.modules[known_as] = module_from_spec(spec)
        try:
            exec(compile(code, path, "exec"), vars(module))
        except BaseException:
            del sys.modules[known_as]
            raise
    return sys.modules[known_as]
