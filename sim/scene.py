"""A scene: the gel and its moduli, poses of an indenter over it, and the frame in which a contact is solved."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from gelgap.assets import asset_path
from gelgap.assets.settings import PresetSettings, within
from gelgap.assets.toml_file import read_toml
from gelgap.sim.indenter import Floats, Indenter, Symmetry

StrainEnergy = Literal["isochoric", "stable-neo-hookean"]
Length = Annotated[float, within(1.0, 100.0, "mm")]
PadEdges = tuple[float, float, float, float]

# Of `equivalent_moduli`; the file says how they were fitted.
_MODULI = read_toml(asset_path("fitted", "moduli.toml"))

# The contact class of a pose that is not on the paper's grid.
NO_CLASS = -1
# A contact is interior if the pad's edges are further away than this many thicknesses (docs/physics.md), and from its
# rim than the second: meshed, they take 1.7 % of a flat end's force 1.8 thicknesses from its rim, 2.5 % at 1.3.
_INTERIOR_THICKNESSES, _INTERIOR_RIM_THICKNESSES = 2.4, 1.5
_DEEPEST_THICKNESSES = 0.6
_ROUNDING_MM = 1e-9
LARGEST_TURN_DEG = 90.0


@dataclass(frozen=True)
class Moduli:
    """The two moduli of an isotropic solid at small strain: E above 0, and ν from 0 to below 0.5."""

    young_modulus_mpa: float
    poisson_ratio: float

    @property
    def shear_mpa(self) -> float:
        """Return μ."""
        return self.young_modulus_mpa / (2 * (1 + self.poisson_ratio))

    @property
    def lame_mpa(self) -> float:
        """Return λ, Lamé's first parameter."""
        young, poisson = self.young_modulus_mpa, self.poisson_ratio
        return young * poisson / ((1 + poisson) * (1 - 2 * poisson))


def equivalent_moduli(isochoric: Moduli) -> Moduli:
    """Return the moduli with which MuJoCo's Stable Neo-Hookean gel presses like an isochoric one.

    "Neo-Hookean with E and ν" is not one material: the energies agree at small strain and as ν → 1/2, but a press to a
    third of a pad's thickness is 4.5 % softer in MuJoCo's form at ν = 0.45. With x = 1 − 2ν, E′/E = 1 + x (a + b x) and
    ν′ = ν + x (c + d x) make force and surface of a press agree as well as two numbers allow.

    Calibrated on locking-free axisymmetric solves of both energies, for 0.3 ≤ ν < 0.5 and depths up to a third of the
    thickness and two thirds of the sphere's radius; below 0.3 the shift is that of 0.3. What remains is a trend with
    depth, because E′ cannot be right at small and at large strain together: see docs/physics-reference.md.
    """
    x = 1 - 2 * max(isochoric.poisson_ratio, _MODULI["smallest_poisson_ratio"])
    a, b = _MODULI["modulus"]
    c, d = _MODULI["poisson"]
    return Moduli(
        isochoric.young_modulus_mpa * (1 + x * (a + b * x)),
        max(0.0, isochoric.poisson_ratio + x * (c + d * x)),
    )


class Elastomer(PresetSettings):
    """A pad of neo-Hookean gel bonded to a rigid backing, which a spring may carry.

    The gel's energy is `isochoric`, μ/2 (J^(−2/3) I₁ − 3) + K/2 (J − 1)², unless `stable-neo-hookean` asks for the
    energy that MuJoCo itself uses, μ/2 (I₁ − 3) − μ (J − 1) + (λ + μ)/2 (J − 1)².
    """

    preset_kind: ClassVar[str] = "elastomers"

    young_modulus_mpa: Annotated[float, within(0.001, 100.0, "MPa")] = Field(
        description="Young's modulus at small strain, MPa, 0.001 to 100."
    )
    poisson_ratio: Annotated[float, within(0.0, 0.5, "", high_open=True)] = Field(
        description="Poisson's ratio, 0 to below 0.5."
    )
    friction: Annotated[float, within(0.0, 1000.0, "")] = Field(
        description="Coulomb friction coefficient between gel and indenter, 0 to 1000; 10 and more is no slip."
    )
    thickness_mm: Annotated[float, within(0.2, 50.0, "mm")] = Field(
        default=3.0, description="Thickness of the pad, mm, 0.2 to 50."
    )
    pad_size_mm: tuple[Length, Length] = Field(
        default=(24.0, 20.0), description="Size of the pad along x and y, mm, 1 to 100 each."
    )
    mount_stiffness_n_per_mm: Annotated[float, within(0.01, 1e6, "N/mm")] | None = Field(
        default=None,
        description="Stiffness of the spring between indenter drive and gel, the same in x, y and z, N/mm; "
        "none: a rigid rig.",
    )
    strain_energy: StrainEnergy = Field(
        default="isochoric", description="The form of the neo-Hookean energy that the two moduli refer to."
    )
    static_friction: Annotated[float, within(0.0, 1000.0, "")] | None = Field(
        default=None,
        description="Friction coefficient before slip, which lowers it to `friction` over 0.05 mm, up to 1000; "
        "none: `friction`.",
        exclude_if=lambda value: value is None,
    )

    @field_validator("static_friction")
    @classmethod
    def _check_static_friction(cls, value: float | None, info: ValidationInfo) -> float | None:
        if value is None:
            return None
        kinetic = info.data.get("friction", value)
        if value < kinetic or value > kinetic == 0:
            raise ValueError(f"must be at least friction, {kinetic:g}, and equal to it if that is 0")
        return value

    @property
    def mujoco_moduli(self) -> Moduli:
        """The moduli with which MuJoCo's energy acts as this gel's."""
        own = Moduli(self.young_modulus_mpa, self.poisson_ratio)
        return equivalent_moduli(own) if self.strain_energy == "isochoric" else own


def deepest_mm(elastomer: Elastomer, indenter: Indenter) -> float:
    """Return the largest depth that a gel allows: by its thickness and the indenter."""
    return min(_DEEPEST_THICKNESSES * elastomer.thickness_mm, indenter.deepest_mm)


@dataclass(frozen=True)
class Pose:
    """One commanded contact: at a point of the pad, `depth_mm` down, then sideways by the shear in one straight line.

    `contact_class` is 0 for the reference without contact, 1 + 72·depth index + 12·radius index + angle index on the
    paper's grid, and `NO_CLASS` elsewhere. Poses of one `trajectory` are visited in their order, each in a straight
    line from the one before, so that friction depends on all that came before.

    As it goes sideways the indenter turns about its origin, which is a sphere's centre and otherwise the lowest point
    of the axis: about the vector (roll x, roll y, twist), by its length.
    """

    depth_mm: float
    shear_x_mm: float = 0.0
    shear_y_mm: float = 0.0
    point_x_mm: float = 0.0
    point_y_mm: float = 0.0
    point_id: int = 0
    contact_class: int = NO_CLASS
    trajectory: int | None = None
    # Recipes and hashes of contacts that do not turn know nothing of turns.
    twist_deg: Annotated[float, Field(exclude_if=lambda value: not value)] = 0.0
    roll_deg: Annotated[tuple[float, float], Field(exclude_if=lambda value: not any(value))] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for field, values in (("twist_deg", (self.twist_deg,)), ("roll_deg", self.roll_deg)):
            if not all(abs(value) <= LARGEST_TURN_DEG for value in values):
                text = " ".join(f"{value:g}" for value in values)
                raise ValueError(
                    f"{field} = {text}: must be in [−{LARGEST_TURN_DEG:g}, {LARGEST_TURN_DEG:g}]°"
                )
        for field in ("depth_mm", "shear_x_mm", "shear_y_mm", "point_x_mm", "point_y_mm"):
            value = getattr(self, field)
            if not math.isfinite(value):
                raise ValueError(f"{field} = {value!r}: must be a finite number of mm")
        if self.depth_mm < 0:
            raise ValueError(f"depth_mm = {self.depth_mm:g}: must be 0 or more (pressing is positive)")

    @property
    def radius_mm(self) -> float:
        return round(math.hypot(self.shear_x_mm, self.shear_y_mm), 9)

    @property
    def turn_deg(self) -> tuple[float, float, float]:
        """The rotation vector (x, y, z) by which the indenter is turned."""
        return *self.roll_deg, self.twist_deg

    @property
    def angle_deg(self) -> float:
        """Direction of the shear, degrees in [0, 360), from +x towards +y."""
        return round(math.degrees(math.atan2(self.shear_y_mm, self.shear_x_mm)), 9) % 360.0


@dataclass(frozen=True)
class Sharing:
    """Which poses may share a solution; each kind of sharing can be switched off.

    `modulus`: one solve serves every Young's modulus. `translation`: interior points share theirs; under a body of
    revolution directions are then rotations of each other, and half the gel is enough. `reflection`: on a small pad,
    mirrored points and directions share theirs. `path`: poses at one point share descents, off which drags branch at
    their depths. `cache`: solutions are kept on disk.
    """

    modulus: bool = True
    translation: bool = True
    reflection: bool = True
    path: bool = True
    cache: bool = True


@dataclass(frozen=True)
class Scene:
    """What all poses of a plan have in common."""

    elastomer: Elastomer
    indenter: Indenter
    quality: str
    sharing: Sharing

    def indenter_in_frame(self, *, edges: bool) -> Indenter:
        """Return the indenter as its contacts are solved: straightened, unless the pad has `edges` that matter."""
        straight = self.indenter.straightened()
        return self.indenter if edges and straight.symmetry is not Symmetry.REVOLUTION else straight

    def check(self, pose: Pose) -> None:
        """Raise ValueError if a pose lies off the pad, or deeper or further sideways than can be solved."""
        gel, indenter = self.elastomer, self.indenter.turned(pose.turn_deg)
        # A body that is turned about its origin may reach deeper.
        depth_mm = pose.depth_mm + (indenter.origin_height_mm - self.indenter.origin_height_mm)
        for name, size in zip(("point_x_mm", "point_y_mm"), gel.pad_size_mm, strict=True):
            value, half = getattr(pose, name), size / 2
            if abs(value) > half:
                raise ValueError(f"{name} = {value:g}: lies off the pad, must be in [{-half:g}, {half:g}] mm")
        if depth_mm > _ROUNDING_MM > pose.depth_mm:
            deep = f"the turned indenter ({indenter.label}) still reaches {depth_mm:.3g} mm deep"
            raise ValueError(f"depth_mm = {pose.depth_mm:g}: {deep}; must be more than 0 mm, or turned back")
        deepest = deepest_mm(gel, indenter)
        if depth_mm > deepest + _ROUNDING_MM:
            raise ValueError(
                f"depth_mm = {depth_mm:g}: must be in [0, {deepest:g}] mm, at most {_DEEPEST_THICKNESSES:g} of "
                f"the pad's thickness and {indenter.deepest_mm:g} mm for the indenter ({indenter.label})"
            )
        indenter.check(depth_mm)
        if pose.radius_mm > gel.thickness_mm:
            raise ValueError(
                f"shear = {pose.radius_mm:g} mm: must be at most the pad's thickness, {gel.thickness_mm:g} mm"
            )


@dataclass(frozen=True, eq=False)
class CanonicalFrame:
    """Where a contact is solved.

    `pad_mm` is (x min, x max, y min, y max) of the pad around the contact point, None if its edges are too far to
    matter; it is the same for all points that share their solutions. `to_sensor` (2, 2) is orthogonal, a
    rotation or a reflection, and leads from this frame's plane to the sensor's.
    """

    pad_mm: PadEdges | None
    to_sensor: Floats

    def travel_mm(self, pose: Pose) -> Floats:
        """Return the sideways travel (2,) of a pose in this frame."""
        return self.to_sensor.T @ np.array([pose.shear_x_mm, pose.shear_y_mm])

    def points_mm(self, x_mm: Floats, y_mm: Floats, pose: Pose) -> Floats:
        """Return the points (ny, nx, 2) of a grid on the sensor, from a pose's contact point and in this frame."""
        from_point_mm = np.stack(np.meshgrid(x_mm - pose.point_x_mm, y_mm - pose.point_y_mm), axis=-1)
        return (from_point_mm.reshape(-1, 2) @ self.to_sensor).reshape(from_point_mm.shape)

    def command(self, pose: Pose) -> tuple[float, ...]:
        """Return how far the indenter goes (x, y, z), mm, and turns (x, y, z), degrees, in this frame."""
        turn = np.linalg.det(self.to_sensor).round() * (self.to_sensor_3d.T @ np.array(pose.turn_deg))
        x, y, *turn_deg = np.round([*self.travel_mm(pose), *turn], 12).tolist()
        return x, y, -pose.depth_mm, *turn_deg

    @property
    def to_sensor_3d(self) -> Floats:
        """The same for vectors (3,) in space."""
        turn = np.eye(3)
        turn[:2, :2] = self.to_sensor
        return turn

    def on_sensor(self, vectors: Floats) -> Floats:
        """Return vectors (…, 3) of this frame, a force or a field, in the sensor's."""
        return (vectors.reshape(-1, 3) @ self.to_sensor_3d.T).reshape(vectors.shape)

    def torque_on_sensor(self, torque: Floats) -> Floats:
        """Return a torque (3,) of this frame in the sensor's: a reflection turns it round."""
        return np.linalg.det(self.to_sensor).round() * self.on_sensor(torque) + 0.0


def is_interior(elastomer: Elastomer, indenter: Indenter, pose: Pose) -> bool:
    """Return whether the pad's edges are too far from a contact to matter."""
    to_edge_mm = np.array(elastomer.pad_size_mm) / 2 - np.abs([pose.point_x_mm, pose.point_y_mm])
    half_cut_mm = np.abs(indenter.cut_mm(pose.depth_mm)).max(axis=1) if pose.depth_mm else np.zeros(2)
    in_thicknesses = np.array([to_edge_mm, to_edge_mm - half_cut_mm]).min(axis=1) / elastomer.thickness_mm
    return bool((in_thicknesses >= [_INTERIOR_THICKNESSES, _INTERIOR_RIM_THICKNESSES]).all())


def canonical_frame(scene: Scene, pose: Pose) -> CanonicalFrame:
    """Return the frame of a pose, by the symmetries that pad and indenter have and `scene.sharing` allows.

    The travel of an interior pose under a body of revolution is turned to +x; another body is solved straightened, in a
    frame that is turned. Other poses are mirrored to the pad's first quadrant, where their travel decides if they lie
    on an axis of the pad.
    """
    elastomer, sharing = scene.elastomer, scene.sharing
    half_x, half_y = elastomer.pad_size_mm[0] / 2, elastomer.pad_size_mm[1] / 2
    x, y = pose.point_x_mm, pose.point_y_mm
    interior = sharing.translation and is_interior(elastomer, scene.indenter, pose)
    indenter = scene.indenter_in_frame(edges=not interior)
    if interior and indenter.symmetry is Symmetry.REVOLUTION:
        x, y = pose.shear_x_mm, pose.shear_y_mm
        if not pose.radius_mm and any(pose.roll_deg):
            # A roll about y leads along x.
            x, y = pose.roll_deg[1], -pose.roll_deg[0]
        return CanonicalFrame(None, plane_rotation(math.atan2(y, x)))
    turn = plane_rotation(math.radians(scene.indenter.yaw - indenter.yaw))
    x, y = (0.0, 0.0) if interior else (x, y)
    shear_x, shear_y = turn.T @ [pose.shear_x_mm, pose.shear_y_mm]
    mirror = np.ones(2)
    if sharing.reflection and Symmetry.MIRROR_X in indenter.symmetry:
        mirror[0] = -1.0 if x < 0 or (x == 0 and shear_x < -1e-12) else 1.0
    if sharing.reflection and Symmetry.MIRROR_Y in indenter.symmetry:
        mirror[1] = -1.0 if y < 0 or (y == 0 and shear_y < -1e-12) else 1.0
    x, y = x * mirror[0] + 0.0, y * mirror[1] + 0.0
    edges = (-half_x - x, half_x - x, -half_y - y, half_y - y)
    pad = None if interior else tuple(round(edge, 9) + 0.0 for edge in edges)
    return CanonicalFrame(pad, turn @ np.diag(mirror))


def plane_rotation(angle: float) -> Floats:
    """Return the matrix (2, 2) that turns by an angle in radians, from x towards y."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])
