"""The known methods: their names, without torch, and their classes and settings.

A new one is a class in this folder and a line in `METHODS`. Further ones come from outside: by `register`, from the
entry points of installed packages, or as `module:Class` or `file.py:Class`.
"""

from contextlib import suppress
from functools import cache
from importlib.metadata import entry_points
from inspect import getsourcefile
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING

from gelgap.adapt.own_code import code_sha256, imported
from gelgap.assets.names import unknown_name
from gelgap.assets.toml_file import named_in_errors

if TYPE_CHECKING:
    from gelgap.adapt.methods.base import Method, MethodSettings
    from gelgap.adapt.profile import Profile

METHODS = {
    "constant-mean": "controls:ConstantMean",
    "source-only": "controls:SourceOnly",
    "adabn": "controls:AdaBN",
    "no-transfer": "controls:NoTransfer",
    "classifier-only": "controls:ClassifierOnly",
    "dan": "mmd:DAN",
    "jan": "mmd:JAN",
    "dann": "dann:DANN",
    "cdan": "dann:CDAN",
    "rsd": "rsd:RSD",
    "daregram": "daregram:DAREGRAM",
    "dsan": "mmd:DSAN",
    "uga": "uga:UGA",
    "fourier-style": "fourier_style:FourierStyle",
    "supervised": "controls:Supervised",
}
EXTRA: "dict[str, type[Method]]" = {}
"""Methods from outside that are loaded, by name."""
_CODE: dict[str, str] = {}
"""Hashes of the files of methods from outside, by name: results of changed code are not taken for the same."""
ENTRY_POINTS = "gelgap.methods"
"""The group in which a package declares its methods: a name, and `module:Class`."""


@cache
def installed_methods() -> dict[str, str]:
    """Return the methods that installed packages declare, `module:Class` by name."""
    return {entry.name: entry.value for entry in entry_points(group=ENTRY_POINTS)}


def method_names() -> tuple[str, ...]:
    """Return the names of all methods."""
    return tuple(dict.fromkeys((*METHODS, *EXTRA, *installed_methods())))


def register(name: str, method: "type[Method]") -> None:
    """Make a method of another package known under a name; a change of its file makes new runs, not one of a notebook.

    Raises
    ------
    ValueError
        If the name is taken.
    """
    if name in method_names():
        raise ValueError(f"method name {name!r} is taken")
    with suppress(TypeError, OSError):  # in a notebook it has no file
        _keep(name, method)


def use_method(name: str) -> str:
    """Return the name of a method that may also stand as `module:Class` or `file.py:Class`; such a class is registered.

    Its name for results is `module.Class`. This runs the code of that module.

    Raises
    ------
    ValueError
        If there is no such method, or the module or class is not one.
    """
    if ":" not in name:
        find_method(name)
        return name
    method, (module_name, _, class_name) = _load(name), name.rpartition(":")
    own = f"{Path(module_name.removesuffix('.py')).name}.{class_name}"
    if own in METHODS or getsourcefile(EXTRA.get(own, method)) != getsourcefile(method):
        raise ValueError(f"method {name!r}: the name {own} is taken by another method")
    _keep(own, method)
    return own


def method_code(name: str) -> str | None:
    """Return a hash of the code of a method from outside; None for those of gelgap and of a notebook."""
    return _CODE.get(name)


def find_method(name: str) -> "type[Method]":
    """Return a method's class.

    Raises
    ------
    ValueError
        If there is no such method; the message lists the known ones.
    """
    if name in METHODS:
        return resolve_name(f"gelgap.adapt.methods.{METHODS[name]}")
    if name not in method_names():
        raise ValueError(unknown_name("method", name, (*method_names(), "FILE.py:CLASS"), "known methods"))
    if name not in EXTRA:
        _keep(name, _load(installed_methods()[name]))
    return EXTRA[name]


def method_settings(name: str, profile: "Profile") -> "MethodSettings":
    """Return a method's settings, with what the profile changes of them.

    Raises
    ------
    ValueError
        If there is no such method, or the profile gives it a setting that it cannot have.
    """
    settings = find_method(name).Settings
    with named_in_errors(f"settings of method {name}"):
        return settings(**profile.settings.get(name, {}))


def make_method(name: str, profile: "Profile", n_classes: int, n_labels: int = 3, seed: int = 0) -> "Method":
    """Return a method with the profile's settings for it; what it owns as parameters is drawn by the seed."""
    import torch

    kind = find_method(name)
    settings = method_settings(name, profile)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return kind(settings, profile.feature_dim, n_classes, n_labels)


def _keep(name: str, method: "type[Method]") -> None:
    EXTRA[name] = method
    _CODE[name] = code_sha256(method)


def _load(place: str) -> "type[Method]":
    """Return the class at `module:Class` or `file.py:Class`."""
    from gelgap.adapt.methods.base import Method

    module, class_name = imported(place, "method")
    methods = {
        name: kind
        for name, kind in vars(module).items()
        if isinstance(kind, type) and issubclass(kind, Method)
    }
    if class_name not in methods:
        own = [name for name, kind in methods.items() if kind.__module__ == module.__name__]
        raise ValueError(
            f"method {place!r}: {class_name or 'nothing'} is not a class of {place.rpartition(':')[0]} that extends "
            f"gelgap.adapt.Method; it has {', '.join(own) or 'none'}"
        )
    return methods[class_name]
