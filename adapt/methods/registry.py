"""The known methods by name. A new one is a file in this folder and a line in `METHODS`, or comes from outside."""

from importlib import import_module

from gelgap.adapt.methods.base import Method, MethodSettings
from gelgap.adapt.methods.outside import code_digest, installed_methods, load_method
from gelgap.adapt.profile import Profile
from gelgap.assets.names import unknown_name

METHODS = {
    "constant-mean": "constant_mean.ConstantMean",
    "source-only": "source_only.SourceOnly",
    "adabn": "adabn.AdaBN",
    "no-transfer": "no_transfer.NoTransfer",
    "coral": "coral.DeepCORAL",
    "dan": "dan.DAN",
    "jan": "jan.JAN",
    "dann": "dann.DANN",
    "rsd": "rsd.RSD",
    "daregram": "daregram.DAREGRAM",
    "daregram-published": "daregram.PublishedDAREGRAM",
    "daregram-tikhonov": "daregram.TikhonovDAREGRAM",
    "dsan": "dsan.DSAN",
    "dsan-coarse": "dsan.CoarseDSAN",
    "dsan-soft": "dsan.SoftDSAN",
    "cod": "cod.COD",
    "ssa": "ssa.SSA",
    "supervised": "supervised.Supervised",
}
_EXTRA: dict[str, type[Method]] = {}
_CODE: dict[str, str] = {}
"""A hash of the code of methods from outside, by name."""


def method_names() -> tuple[str, ...]:
    """Return the names of all methods."""
    installed = (name for name in installed_methods() if name not in METHODS and name not in _EXTRA)
    return (*METHODS, *_EXTRA, *installed)


def register(name: str, method: type[Method]) -> None:
    """Make a method of another package known under a name.

    Raises
    ------
    ValueError
        If the name is taken.
    """
    if name in method_names():
        raise ValueError(f"method name {name!r} is taken")
    _EXTRA[name] = method


def use_method(name: str) -> str:
    """Return the name of a method that may also stand as `module:Class` or `file.py:Class`; such a class is registered.

    Raises
    ------
    ValueError
        If there is no such method, or the module or class is not one.
    """
    if ":" not in name:
        find_method(name)
        return name
    own, method = load_method(name)
    if own in METHODS or _EXTRA.get(own, method) is not method:
        raise ValueError(f"method {name!r}: the name {own} is taken by another method")
    _EXTRA[own], _CODE[own] = method, code_digest(method)
    return own


def method_code(name: str) -> str | None:
    """Return a hash of the code of a method from outside; None for those of gelgap and of `register`."""
    return _CODE.get(name)


def find_method(name: str) -> type[Method]:
    """Return a method's class.

    Raises
    ------
    ValueError
        If there is no such method; the message lists the known ones.
    """
    if name in _EXTRA:
        return _EXTRA[name]
    if name not in METHODS and (place := installed_methods().get(name)):
        _, method = load_method(place)
        _EXTRA[name], _CODE[name] = method, code_digest(method)
        return method
    if name not in METHODS:
        raise ValueError(
            f"{unknown_name('method', name, method_names(), 'known methods')}; your own: module:Class or file.py:Class"
        )
    module, _, attribute = METHODS[name].rpartition(".")
    return getattr(import_module(f"gelgap.adapt.methods.{module}"), attribute)


def method_settings(name: str, profile: Profile) -> MethodSettings:
    """Return a method's settings, with what the profile changes of them.

    Raises
    ------
    ValueError
        If there is no such method, or the profile gives it a setting that it cannot have.
    """
    settings = find_method(name).Settings
    try:
        return settings(**profile.settings.get(name, {}))
    except ValueError as error:
        raise ValueError(f"settings of method {name}: {error}") from error


def make_method(name: str, profile: Profile, n_classes: int) -> Method:
    """Return a method with the profile's settings for it."""
    return find_method(name)(method_settings(name, profile), profile.feature_dim, n_classes)


def transfer_weight(name: str, profile: Profile) -> float:
    """Return λ_t of a method: the profile's, unless its settings for the method say otherwise."""
    return method_settings(name, profile).final_weight(profile)
