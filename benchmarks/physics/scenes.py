"""Random scenes that stress the physics: the corners of a box of parameters, and scenes drawn from it by number."""

import itertools
from dataclasses import dataclass

import numpy as np

from gelgap.sim import Elastomer, Pose, Sphere

YOUNG_MPA = (0.01, 10.0)
POISSON = (0.3, 0.495)
FRICTION = (0.0, 1.5)
RADIUS_MM = (0.5, 5.0)
THICKNESS_MM = (1.0, 6.0)
STEP_MM = (0.01, 0.5)
PAD_SIZE_MM = (24.0, 20.0)
GEL_FIELDS = ("young_modulus_mpa", "poisson_ratio", "friction", "thickness_mm")
CORNERS = 2**5
POSES_DOWN, POSES_SIDEWAYS = 4, 3


@dataclass(frozen=True)
class Scene:
    """A press in steps, then a drag in steps, of which the last few are recorded."""

    number: int
    quality: str
    elastomer: Elastomer
    indenter: Sphere
    depth_mm: float
    step_down_mm: float
    step_sideways_mm: float
    direction_deg: float
    point_x_mm: float
    point_y_mm: float

    @property
    def poses(self) -> tuple[Pose, ...]:
        place = {"point_x_mm": self.point_x_mm, "point_y_mm": self.point_y_mm}
        down = [self.depth_mm - k * self.step_down_mm for k in reversed(range(POSES_DOWN))]
        furthest = min(self.elastomer.thickness_mm, self.indenter.radius_mm)
        travels = [k * self.step_sideways_mm for k in range(1, POSES_SIDEWAYS + 1)]
        drags = [np.round(travel * self.direction, 9) for travel in travels if travel <= furthest]
        return (
            *(Pose(depth_mm=round(depth, 9), **place) for depth in down if depth > 1e-6),
            *(Pose(depth_mm=self.depth_mm, shear_x_mm=x, shear_y_mm=y, **place) for x, y in drags),
        )

    @property
    def direction(self) -> np.ndarray:
        """The unit vector (2,) of the drag."""
        angle = np.radians(self.direction_deg)
        return np.array([np.cos(angle), np.sin(angle)])

    @property
    def in_papers_regime(self) -> bool:
        return (
            self.elastomer.poisson_ratio <= 0.49
            and self.depth_mm <= self.elastomer.thickness_mm / 3
            and max(self.step_down_mm, self.step_sideways_mm) <= 0.2
        )

    @property
    def contact_mm(self) -> float:
        """More than the contact's radius: where a paraboloid at that depth meets the undeformed membrane."""
        return float(np.sqrt(self.indenter.diameter_mm * self.depth_mm))

    @property
    def to_rim_mm(self) -> float:
        return min(PAD_SIZE_MM[0] / 2 - abs(self.point_x_mm), PAD_SIZE_MM[1] / 2 - abs(self.point_y_mm))

    def command(self) -> str:
        """Return a line that presses the scene's last pose by itself."""
        fields = ("depth_mm", "shear_x_mm", "shear_y_mm", "point_x_mm", "point_y_mm")
        gel = {name: getattr(self.elastomer, name) for name in GEL_FIELDS}
        pose = {name: getattr(self.poses[-1], name) for name in fields}
        values = gel | {"indenter_diameter_mm": self.indenter.diameter_mm} | pose
        options = " ".join(f"--{name.replace('_', '-')} {value:.9g}" for name, value in values.items())
        return f"gelgap press {options} --quality {self.quality} --json"


def numbered_scene(number: int, quality: str) -> Scene:
    """Return scene `number`: a corner of the box, or one drawn at random."""
    return _corner(number, quality) if number < CORNERS else _drawn(number, quality)


def _corner(number: int, quality: str) -> Scene:
    corners = list(itertools.product(YOUNG_MPA, POISSON, FRICTION, RADIUS_MM, THICKNESS_MM))
    *moduli, radius, thickness = corners[number]
    return Scene(
        number,
        quality,
        _gel(*moduli, thickness),
        Sphere(diameter_mm=2 * radius),
        depth_mm=round(min(0.4 * thickness, 0.8 * radius), 6),
        step_down_mm=STEP_MM[number % 2],
        step_sideways_mm=STEP_MM[number // 2 % 2],
        direction_deg=0.0,
        point_x_mm=PAD_SIZE_MM[0] / 2 if number // 4 % 2 else 0.0,
        point_y_mm=0.0,
    )


def _drawn(number: int, quality: str) -> Scene:
    rng = np.random.default_rng(np.random.SeedSequence([20240, number]))

    def uniform(low: float, high: float, digits: int = 6) -> float:
        return round(float(rng.uniform(low, high)), digits)

    def logarithmic(bounds: tuple[float, float]) -> float:
        return round(float(np.exp(rng.uniform(*np.log(bounds)))), 6)

    # The order of the draws is part of a scene's identity.
    radius, thickness = logarithmic(RADIUS_MM), uniform(*THICKNESS_MM)
    gel = _gel(logarithmic(YOUNG_MPA), uniform(*POISSON), uniform(*FRICTION), thickness)
    return Scene(
        number,
        quality,
        gel,
        Sphere(diameter_mm=2 * radius),
        depth_mm=round(float(rng.uniform(0.05, 1.0)) * min(0.4 * thickness, 0.8 * radius), 6),
        step_down_mm=logarithmic(STEP_MM),
        step_sideways_mm=logarithmic(STEP_MM),
        direction_deg=uniform(0, 360, 3),
        point_x_mm=round(float(rng.uniform(-1, 1)) * PAD_SIZE_MM[0] / 2, 4),
        point_y_mm=round(float(rng.uniform(-1, 1)) * PAD_SIZE_MM[1] / 2, 4),
    )


def _gel(*values: float) -> Elastomer:
    return Elastomer(**dict(zip(GEL_FIELDS, values, strict=True)), pad_size_mm=PAD_SIZE_MM)
