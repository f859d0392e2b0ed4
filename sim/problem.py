"""One physics problem: everything that decides the outcome of a solve, and nothing else."""

import hashlib
import json
import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.indenters.base import Indenter, Symmetry
from gelgap.sim.indenters.registry import AnyIndenter
from gelgap.sim.material import Moduli
from gelgap.sim.mesh.scale import contact_width
from gelgap.sim.quality import MeshSize, Quality

# Part of every key: raise it when the method changes, so that cached solutions of the old one are not taken.
_METHOD_VERSION = 20
_WIDE_CONTACT_VERSION = 21  # of contacts wider than the gel is thick

Waypoint = tuple[float, float, float]
PadEdges = tuple[float, float, float, float]


@dataclass(frozen=True)
class ContactProblem:
    """An indenter led through waypoints over a gel, in a frame with the contact point as its origin.

    `moduli` are the material's, for MuJoCo's energy. `pad_mm` is (x min, x max, y min, y max) of the pad around the
    contact point; None stands for a pad without edges, a disc whose rim is too far to matter. `waypoints_mm` are
    commanded displacements (x, y, z) of the indenter from touching the gel; a state is recorded at each. `parents` says
    for each from which waypoint it is reached, by its index, −1 for the undeformed gel: several drags can branch off
    one press.
    """

    moduli: Moduli
    friction: float
    thickness_mm: float
    indenter: AnyIndenter
    mount_stiffness_n_per_mm: float | None
    pad_mm: PadEdges | None
    waypoints_mm: tuple[Waypoint, ...]
    parents: tuple[int, ...]
    quality: Quality

    @property
    def symmetric(self) -> bool:
        """Whether indenter, gel and waypoints are symmetric about y = 0, so that only y ≥ 0 is solved."""
        _, _, y_min, y_max = self.pad_mm or (0.0, 0.0, 0.0, 0.0)
        straight = y_max == -y_min and all(y == 0 for _, y, _ in self.waypoints_mm)
        return straight and self.indenter.symmetry is not Symmetry.NONE

    @property
    def mesh_size(self) -> MeshSize:
        """The size of the mesh: finer for half a disc without edges, which takes a fifth of a whole pad's work."""
        return self.quality.disc if self.pad_mm is None and self.symmetric else self.quality.pad

    @property
    def travel_mm(self) -> float:
        """How far sideways the indenter goes."""
        return max(math.hypot(x, y) for x, y, _ in self.waypoints_mm)

    @property
    def depth_mm(self) -> float:
        """How deep the indenter goes."""
        return max(-z for _, _, z in self.waypoints_mm)

    @property
    def penetration_radius_mm(self) -> float:
        """The radius within which the indenter, at its deepest, cuts the undeformed membrane."""
        return self.indenter.penetration_radius_mm(self.depth_mm)

    @property
    def contact_width(self) -> float:
        """How wide the contact is, in thicknesses of the gel; 1 if it is narrower."""
        return contact_width(self.indenter, self.thickness_mm, self.depth_mm)

    @property
    def segments_mm(self) -> NDArray[np.float64]:
        """The straight segment (start, end) to each waypoint from its parent, (n, 2, 3)."""
        places = np.array([*self.waypoints_mm, (0.0, 0.0, 0.0)])
        return np.stack([places[list(self.parents)], places[:-1]], axis=1)

    @property
    def load_steps(self) -> int:
        """The number of load steps through all waypoints, not counting halved ones."""
        return sum(self.quality.load_steps(end - start) for start, end in self.segments_mm)

    @property
    def key(self) -> str:
        """A hash of the physics and of the method that solves it."""
        version = _WIDE_CONTACT_VERSION if self.contact_width > 1 else _METHOD_VERSION
        values = {"method": version, "shape": self.indenter.shape, **asdict(self)}
        text = json.dumps(values, sort_keys=True, default=Indenter.model_dump)
        return hashlib.sha256(text.encode()).hexdigest()
