"""Random scenes that stress the physics: the corners of a box of parameters, and scenes drawn from it by number."""

import itertools
from dataclasses import dataclass

import numpy as np

from gelgap.sim import Elastomer, Pose

YOUNG_MPA = (0.01, 10.0)
POISSON = (0.3, 0.495)
FRICTION = (0.0, 1.5)
RADIUS_MM = (0.5, 5.0)
THICKNESS_MM = (1.0, 6.0)
STEP_MM = (0.01, 0.5)
PAD_SIZE_MM = (24.0, 20.0)
CORNERS = 2**5
POSES_DOWN, POSES_SIDEWAYS = 4, 3


@dataclass(frozen=True)
class Scene:
    """A press in steps, then a drag in steps, of which the last few are recorded."""

    number: int
    young_modulus_mpa: float
    poisson_ratio: float
    friction: float
    indenter_radius_mm: float
    thickness_mm: float
    depth_mm: float
    step_down_mm: float
    step_sideways_mm: float
    direction_deg: float
    point_x_mm: float
    point_y_mm: float
    quality: str

    @property
    def elastomer(self) -> Elastomer:
        return Elastomer(
            young_modulus_mpa=self.young_modulus_mpa,
            poisson_ratio=self.poisson_ratio,
            friction=self.friction,
            thickness_mm=self.thickness_mm,
            pad_size_mm=PAD_SIZE_MM,
        )

    @property
    def poses(self) -> tuple[Pose, ...]:
        place = {"point_x_mm": self.point_x_mm, "point_y_mm": self.point_y_mm}
        down = [self.depth_mm - k * self.step_down_mm for k in reversed(range(POSES_DOWN))]
        furthest = min(self.thickness_mm, self.indenter_radius_mm)
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
            self.poisson_ratio <= 0.49
            and self.depth_mm <= self.thickness_mm / 3
            and max(self.step_down_mm, self.step_sideways_mm) <= 0.2
        )

    @property
    def contact_mm(self) -> float:
        """More than the contact's radius: where a paraboloid at that depth meets the undeformed membrane."""
        return float(np.sqrt(2 * self.indenter_radius_mm * self.depth_mm))

    @property
    def to_rim_mm(self) -> float:
        return min(PAD_SIZE_MM[0] / 2 - abs(self.point_x_mm), PAD_SIZE_MM[1] / 2 - abs(self.point_y_mm))

    def command(self) -> str:
        """Return a line that presses the scene's last pose by itself."""
        last = self.poses[-1]
        values = {
            "young-modulus-mpa": self.young_modulus_mpa,
            "poisson-ratio": self.poisson_ratio,
            "friction": self.friction,
            "thickness-mm": self.thickness_mm,
            "indenter-diameter-mm": 2 * self.indenter_radius_mm,
            "depth-mm": last.depth_mm,
            "shear-x-mm": last.shear_x_mm,
            "shear-y-mm": last.shear_y_mm,
            "point-x-mm": last.point_x_mm,
            "point-y-mm": last.point_y_mm,
        }
        options = " ".join(f"--{name} {value:.9g}" for name, value in values.items())
        return f"gelgap press {options} --quality {self.quality} --json"


def numbered_scene(number: int, quality: str) -> Scene:
    """Return scene `number`: a corner of the box, or one drawn at random."""
    return _corner(number, quality) if number < CORNERS else _drawn(number, quality)


def _corner(number: int, quality: str) -> Scene:
    corners = list(itertools.product(YOUNG_MPA, POISSON, FRICTION, RADIUS_MM, THICKNESS_MM))
    young, poisson, friction, radius, thickness = corners[number]
    return Scene(
        number=number,
        young_modulus_mpa=young,
        poisson_ratio=poisson,
        friction=friction,
        indenter_radius_mm=radius,
        thickness_mm=thickness,
        depth_mm=round(min(0.4 * thickness, 0.8 * radius), 6),
        step_down_mm=STEP_MM[number % 2],
        step_sideways_mm=STEP_MM[number // 2 % 2],
        direction_deg=0.0,
        point_x_mm=PAD_SIZE_MM[0] / 2 if number // 4 % 2 else 0.0,
        point_y_mm=0.0,
        quality=quality,
    )


def _drawn(number: int, quality: str) -> Scene:
    rng = np.random.default_rng(np.random.SeedSequence([20240, number]))

    def logarithmic(bounds: tuple[float, float]) -> float:
        return round(float(np.exp(rng.uniform(*np.log(bounds)))), 6)

    radius, thickness = logarithmic(RADIUS_MM), round(float(rng.uniform(*THICKNESS_MM)), 6)
    deepest = min(0.4 * thickness, 0.8 * radius)
    return Scene(
        number=number,
        young_modulus_mpa=logarithmic(YOUNG_MPA),
        poisson_ratio=round(float(rng.uniform(*POISSON)), 6),
        friction=round(float(rng.uniform(*FRICTION)), 6),
        indenter_radius_mm=radius,
        thickness_mm=thickness,
        depth_mm=round(float(rng.uniform(0.05, 1.0)) * deepest, 6),
        step_down_mm=logarithmic(STEP_MM),
        step_sideways_mm=logarithmic(STEP_MM),
        direction_deg=round(float(rng.uniform(0, 360)), 3),
        point_x_mm=round(float(rng.uniform(-1, 1)) * PAD_SIZE_MM[0] / 2, 4),
        point_y_mm=round(float(rng.uniform(-1, 1)) * PAD_SIZE_MM[1] / 2, 4),
        quality=quality,
    )
