"""The names of the known methods, without torch. A new one is a file in this folder and a line in `METHODS`.

Further ones come from outside: by `register`, or from the entry points of installed packages.
"""

from functools import cache
from importlib.metadata import entry_points
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gelgap.adapt.methods.base import Method

METHODS = {
    "constant-mean": "constant_mean.ConstantMean",
    "source-only": "source_only.SourceOnly",
    "adabn": "adabn.AdaBN",
    "no-transfer": "no_transfer.NoTransfer",
    "classifier-only": "classifier_only.ClassifierOnly",
    "coral": "coral.DeepCORAL",
    "dan": "dan.DAN",
    "jan": "jan.JAN",
    "dann": "dann.DANN",
    "cdan": "cdan.CDAN",
    "rsd": "rsd.RSD",
    "daregram": "daregram.DAREGRAM",
    "daregram-published": "daregram.PublishedDAREGRAM",
    "daregram-tikhonov": "daregram.TikhonovDAREGRAM",
    "dsan": "dsan.DSAN",
    "dsan-unmasked": "dsan.UnmaskedDSAN",
    "dsan-coarse": "dsan.CoarseDSAN",
    "dsan-soft": "dsan.SoftDSAN",
    "cod": "cod.COD",
    "conditional-mmd": "conditional_mmd.ConditionalMMD",
    "ssa": "ssa.SSA",
    "tasfar": "tasfar.TASFAR",
    "mean-teacher": "mean_teacher.MeanTeacher",
    "uga": "uga.UGA",
    "importance-weighting": "importance_weighting.ImportanceWeighting",
    "supervised": "supervised.Supervised",
}
EXTRA: "dict[str, type[Method]]" = {}
"""Methods of other packages that are loaded, by name."""
ENTRY_POINTS = "gelgap.methods"
"""The group in which a package declares its methods: a name, and `module:Class`."""


@cache
def installed_methods() -> dict[str, str]:
    """Return the methods that installed packages declare, `module:Class` by name."""
    return {entry.name: entry.value for entry in entry_points(group=ENTRY_POINTS)}


def method_names() -> tuple[str, ...]:
    """Return the names of all methods."""
    installed = (name for name in installed_methods() if name not in METHODS and name not in EXTRA)
    return (*METHODS, *EXTRA, *installed)
