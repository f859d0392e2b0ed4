"""The known methods: their names, without torch, and their classes and settings.

A new one is a class in this folder and a line in `METHODS`, or a class of one's own, named as `FILE.py:CLASS`.
"""

from importlib.metadata import entry_points
from inspect import getsourcefile
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, NamedTuple

from gelgap.adapt.own_code import code_sha256, defined_in
from gelgap.assets.names import left, unknown_name
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
    "daregram": "daregram:DAREGRAM",
    "dsan": "mmd:DSAN",
    "uga": "uga:UGA",
    "supervised": "controls:Supervised",
}
LEFT = ("fourier-style", "rsd")
"""Methods of former versions."""
_FORM = "FILE.py:CLASS"
LEFT_HOOK = "augment_source"
# What a class says of itself is asked before it is made: whether it is given labels of the target, for one.
_FIXED = ("uses_target", "compares_features", "uses_classifier", "uses_target_labels", "needs_stage_1")


class OwnMethod(NamedTuple):
    """A method of the user's own, and the hash of the file that it was read from."""

    kind: "type[Method]"
    code: str


OWN_METHODS: dict[str, OwnMethod] = {}
"""Those that are loaded, by name."""


def method_names() -> tuple[str, ...]:
    """Return the names of all methods."""
    return (*METHODS, *OWN_METHODS)


def check_name(name: str) -> None:
    """Check that a method is known or can be a class of one's own; this runs no code.

    Raises
    ------
    ValueError
        If it is neither; the message lists the known ones, or says in which version it was.
    """
    if ":" in name or name in method_names():
        return
    if name in LEFT:
        raise ValueError(left("method", name))
    if entry_points(group="gelgap.methods", name=name):
        raise ValueError(left("method", name, f"name its file, {_FORM}"))
    raise ValueError(unknown_name("method", name, (*method_names(), _FORM), "known methods"))


def use_method(name: str) -> str:
    """Return the name of a method that may also stand as `FILE.py:CLASS`; then its file is run.

    Its name for results is `file.CLASS`.

    Raises
    ------
    ValueError
        If there is no such method, or the file or class is not one.
    """
    if ":" not in name:
        find_method(name)
        return name
    file, _, class_name = name.rpartition(":")
    method = _load(name)
    filed_as = f"{Path(file).stem}.{class_name}"
    known = OWN_METHODS.get(filed_as)
    if known is not None and getsourcefile(known.kind) != getsourcefile(method):
        raise ValueError(f"method {name!r}: the name {filed_as} is taken by another method")
    OWN_METHODS[filed_as] = OwnMethod(method, code_sha256(method))
    return filed_as


def method_code(name: str) -> str | None:
    """Return a hash of the code of a method of the user's own; None for those of gelgap."""
    return OWN_METHODS[name].code if name in OWN_METHODS else None


def find_method(name: str) -> "type[Method]":
    """Return a method's class.

    Raises
    ------
    ValueError
        If there is no such method; the message lists the known ones.
    """
    if name in METHODS:
        return resolve_name(f"gelgap.adapt.methods.{METHODS[name]}")
    if name not in OWN_METHODS:
        check_name(name)
        raise ValueError(f"method {name!r} is not loaded: `use_method` loads one of your own")
    return OWN_METHODS[name].kind


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
    """Return a method with the profile's settings for it; what it owns as parameters is drawn by the seed.

    Raises
    ------
    ValueError
        If there is no such method, or it says something else of itself than its class does.
    """
    import torch

    kind = find_method(name)
    settings = method_settings(name, profile)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        method = kind(settings, profile.feature_dim, n_classes, n_labels)
    if hasattr(kind, LEFT_HOOK):
        raise ValueError(f"method {name}: {left('the function', LEFT_HOOK)}")
    for what in _FIXED:
        if getattr(method, what) != getattr(kind, what):
            raise ValueError(f"method {name}: {what} must be an attribute of the class, not of an object")
    return method


def _load(place: str) -> "type[Method]":
    """Return the class at `FILE.py:CLASS`."""
    from gelgap.adapt.methods.base import Method

    module, class_name = defined_in(place, "method", _FORM)
    methods = {
        name: kind
        for name, kind in vars(module).items()
        if isinstance(kind, type) and issubclass(kind, Method)
    }
    if class_name not in methods:
        defined = [name for name, kind in methods.items() if kind.__module__ == module.__name__]
        raise ValueError(
            f"method {place!r}: {class_name or 'nothing'} is not a class of {place.rpartition(':')[0]} that extends "
            f"gelgap.adapt.Method; it has {', '.join(defined) or 'none'}"
        )
    return methods[class_name]
