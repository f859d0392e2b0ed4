"""One physics problem: everything that decides the outcome of a solve, and nothing else."""

import hashlib
import json
import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.quality import MeshSize, Quality

# Part of every key: raise it when the method changes, so that cached solutions of the old one are not taken.
_METHOD_VERSION = 19

Waypoint = tuple[float, float, float]


@dataclass(frozen=True)
class ContactProblem:
    """A sphere led through waypoints over a gel, in a frame with the contact point as its origin.

    `young_modulus_mpa` and `poisson_ratio` are the material's, for MuJoCo's energy. `pad_mm` is (x min, x max, y min,
    y max) of the pad around the contact point; None stands for a pad without edges, a disc whose rim is too far to
    matter. `waypoints_mm` are commanded displacements (x, y, z) of the indenter from touching the gel; a state is
    recorded at each. `parents` says for each from which waypoint it is reached, by its index, −1 for the undeformed
    gel: several drags can branch off one press.
    """

    young_modulus_mpa: float
    poisson_ratio: float
    friction: float
    thickness_mm: float
    sphere_radius_mm: float
    mount_stiffness_n_per_mm: float | None
    pad_mm: tuple[float, float, float, float] | None
    waypoints_mm: tuple[Waypoint, ...]
    parents: tuple[int, ...]
    quality: Quality

    @property
    def half(self) -> bool:
        """Whether gel and waypoints are symmetric to y = 0, so that y ≥ 0 is all that is solved."""
        _, _, y_min, y_max = self.pad_mm or (0.0, 0.0, 0.0, 0.0)
        return y_max == -y_min and all(y == 0 for _, y, _ in self.waypoints_mm)

    @property
    def on_half_disc(self) -> bool:
        """Whether half a disc without edges is all that is solved."""
        return self.pad_mm is None and self.half

    @property
    def mesh_size(self) -> MeshSize:
        return self.quality.disc if self.on_half_disc else self.quality.pad

    @property
    def reach_mm(self) -> float:
        """How far sideways the indenter goes."""
        return max(math.hypot(x, y) for x, y, _ in self.waypoints_mm)

    @property
    def depth_mm(self) -> float:
        """How deep the indenter goes."""
        return max(-z for _, _, z in self.waypoints_mm)

    @property
    def contact_mm(self) -> float:
        """The radius in which the sphere, at its deepest, meets the plane of the undeformed membrane."""
        return contact_mm(self.sphere_radius_mm, self.depth_mm)

    @property
    def load_steps(self) -> int:
        """How many load steps lead through all waypoints, but for those that have to be halved."""
        return sum(self.quality.load_steps(end - start) for start, end in self.ways_mm)

    @property
    def ways_mm(self) -> NDArray[np.float64]:
        """The straight way (start, end) to each waypoint from its parent, (n, 2, 3)."""
        places = np.array([*self.waypoints_mm, (0.0, 0.0, 0.0)])
        return np.stack([places[list(self.parents)], places[:-1]], axis=1)

    @property
    def key(self) -> str:
        """A hash of the physics."""
        text = json.dumps({"method": _METHOD_VERSION, **asdict(self)}, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def contact_mm(sphere_radius_mm: float, depth_mm: float) -> float:
    """Return the radius in which a sphere at a depth meets the plane of the undeformed membrane."""
    return math.sqrt(max(sphere_radius_mm**2 - max(sphere_radius_mm - depth_mm, 0.0) ** 2, 0.0))
