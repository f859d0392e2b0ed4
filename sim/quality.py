"""How finely a contact is solved: mesh, load steps and tolerance of the three qualities."""

from dataclasses import dataclass
from typing import Literal

QualityName = Literal["draft", "standard", "fine"]


@dataclass(frozen=True)
class Quality:
    """Lengths in mm for a contact of a 1.5 mm sphere on a 3 mm pad; other scenes scale the mesh to theirs.

    `surface_mm` is the spacing of the membrane's vertices around the contact, `layer_mm` the thickness of the first
    layer, each further one `layer_growth` thicker, `sectors` the number of cells around half a circle. A load step is
    settled when an iteration changes the force by less than a share of it: the tolerance, smaller where the indenter
    goes sideways, since slip settles more slowly.
    """

    name: str
    surface_mm: float
    layer_mm: float
    layer_growth: float
    sectors: int
    press_step_mm: float
    shear_step_mm: float
    press_tolerance: float
    shear_tolerance: float


QUALITIES = {
    "draft": Quality("draft", 0.4, 0.2, 1.5, 8, 0.2, 0.1, 3e-3, 1e-3),
    "standard": Quality("standard", 0.25, 0.12, 1.25, 8, 0.1, 0.1, 1e-3, 3e-4),
    "fine": Quality("fine", 0.16, 0.08, 1.25, 12, 0.05, 0.05, 3e-4, 1e-4),
}


def quality_named(name: str) -> Quality:
    """Return the quality of that name.

    Raises
    ------
    ValueError
        If there is no such quality; the message lists the known ones.
    """
    if name not in QUALITIES:
        raise ValueError(f"quality {name!r} is unknown; known qualities: {', '.join(QUALITIES)}")
    return QUALITIES[name]
