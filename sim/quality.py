"""How finely a contact is solved: mesh, load steps and tolerance of the three qualities."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

QualityName = Literal["draft", "standard", "fine"]


@dataclass(frozen=True)
class MeshSize:
    """How fine a mesh is, for a sphere of 1.5 mm radius on a 3 mm pad; other scenes scale it to theirs.

    `surface_mm` is the spacing of the membrane's vertices around the contact, beyond which each ring of cells is
    `ring_growth` wider than the one before; `layer_mm` is the thickness of the first layer, each further one
    `layer_growth` thicker; `sectors` the number of cells around half a circle. `stiffness` are a and b of
    `material.mesh_moduli`, calibrated for this mesh.
    """

    surface_mm: float
    layer_mm: float
    layer_growth: float
    ring_growth: float
    sectors: int
    stiffness: tuple[float, float]


@dataclass(frozen=True)
class Quality:
    """Meshes and load steps: `disc` for half a disc, `pad` where the pad's edges or a whole pad are meshed.

    A load step is settled when an iteration changes the force by less than the tolerance, as a share of the force. The
    tolerance is smaller where the indenter travels sideways, since slip settles more slowly.
    """

    name: str
    disc: MeshSize
    pad: MeshSize
    press_step_mm: float
    travel_step_mm: float
    press_tolerance: float
    travel_tolerance: float

    def load_steps(self, displacement_mm: NDArray[np.float64]) -> int:
        """Return in how many load steps the indenter moves by (x, y, z) in a straight line."""
        press = abs(displacement_mm[2]) / self.press_step_mm
        travel = math.hypot(displacement_mm[0], displacement_mm[1]) / self.travel_step_mm
        return max(1, math.ceil(max(press, travel) - 1e-9))


# MuJoCo's factor of a whole pad takes five times the work of half a disc's, so that it is meshed more coarsely.
QUALITIES = {
    "draft": Quality(
        name="draft",
        disc=MeshSize(0.4, 0.3, 1.5, 2.0, 8, stiffness=(0.0049, 0.00063)),
        pad=MeshSize(0.5, 0.45, 1.8, 1.8, 8, stiffness=(0.0049, 0.00063)),
        press_step_mm=0.2,
        travel_step_mm=0.1,
        press_tolerance=3e-3,
        travel_tolerance=1e-3,
    ),
    "standard": Quality(
        name="standard",
        disc=MeshSize(0.22, 0.12, 1.8, 1.8, 12, stiffness=(0.0124, 0.00069)),
        pad=MeshSize(0.4, 0.3456, 1.8, 1.8, 8, stiffness=(0.0065, 0.00061)),
        press_step_mm=0.1,
        travel_step_mm=0.1,
        press_tolerance=1e-3,
        travel_tolerance=3e-4,
    ),
    "fine": Quality(
        name="fine",
        disc=MeshSize(0.16, 0.09, 1.5, 1.8, 16, stiffness=(0.0103, 0.00054)),
        pad=MeshSize(0.256, 0.2304, 1.8, 1.8, 12, stiffness=(0.0035, 0.00036)),
        press_step_mm=0.05,
        travel_step_mm=0.05,
        press_tolerance=3e-4,
        travel_tolerance=1e-4,
    ),
}


def quality_named(name: str) -> Quality:
    """Return the quality of that name, or raise ValueError that lists the known ones."""
    if name not in QUALITIES:
        raise ValueError(f"quality {name!r} is unknown; known qualities: {', '.join(QUALITIES)}")
    return QUALITIES[name]
