"""The known methods by name. A new one is a file in this folder and a line in `METHODS`."""

from importlib import import_module

from gelgap.adapt.methods.base import Method, MethodSettings
from gelgap.adapt.profile import Profile

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


def method_names() -> tuple[str, ...]:
    """Return the names of all methods."""
    return (*METHODS, *_EXTRA)


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


def find_method(name: str) -> type[Method]:
    """Return a method's class.

    Raises
    ------
    ValueError
        If there is no such method; the message lists the known ones.
    """
    if name in _EXTRA:
        return _EXTRA[name]
    if name not in METHODS:
        raise ValueError(f"method {name!r} is unknown; known methods: {', '.join(method_names())}")
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
