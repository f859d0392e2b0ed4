"""The known methods: their classes and settings by name."""

from importlib import import_module

from gelgap.adapt.methods.base import Method, MethodSettings
from gelgap.adapt.methods.names import EXTRA, METHODS, installed_methods, method_names
from gelgap.adapt.methods.outside import code_digest, load_method
from gelgap.adapt.profile import Profile
from gelgap.assets.names import unknown_name

_CODE: dict[str, str] = {}
"""A hash of the code of methods from outside, by name."""


def register(name: str, method: type[Method]) -> None:
    """Make a method of another package known under a name.

    Raises
    ------
    ValueError
        If the name is taken.
    """
    if name in method_names():
        raise ValueError(f"method name {name!r} is taken")
    EXTRA[name] = method


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
    if own in METHODS or EXTRA.get(own, method) is not method:
        raise ValueError(f"method {name!r}: the name {own} is taken by another method")
    EXTRA[own], _CODE[own] = method, code_digest(method)
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
    if name in EXTRA:
        return EXTRA[name]
    if name not in METHODS and (place := installed_methods().get(name)):
        _, method = load_method(place)
        EXTRA[name], _CODE[name] = method, code_digest(method)
        return method
    if name not in METHODS:
        raise ValueError(unknown_name("method", name, method_names(), "known methods"))
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
