"""One physics problem: everything that decides the outcome of a solve, how finely it is solved, and nothing else."""

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Literal, Self, cast

import numpy as np

from gelgap.assets import asset_path
from gelgap.assets.names import unknown_name
from gelgap.assets.toml_file import read_toml
from gelgap.sim.indenter import Floats, Indenter, Symmetry
from gelgap.sim.scene import Elastomer, Moduli, PadEdges, Scene
from gelgap.sim.shapes import AnyIndenter

# Above this ν, meshes of linear tetrahedra lock steeply while the gel itself hardly changes: its force rises by 1.7 %
# per hundredth of ν, and the membrane moves by some 5 µm rms at a depth of a third of the thickness. So meshes get this
# ν at most, and a modulus that follows that rise.
LARGEST_POISSON_RATIO = 0.49
# Part of every key: raise it when the method changes, so that cached solutions of the old one are not taken.
_METHOD_VERSION = 37
# A gel of this modulus is solved for all: at fixed friction, geometry and mount over modulus, forces scale with it.
_SHARED_MODULUS_MPA = 0.3
# The file says what was fitted, what was chosen, and what each number does.
MESHES = read_toml(asset_path("fitted", "meshes.toml"))
_CONTACT = SimpleNamespace(**MESHES["contact"])

QualityName = Literal["draft", "standard", "fine"]
Waypoint = tuple[float, float, float]
SolveProgress = Callable[[int, int], None]
"""Called at a solve's begin and after each load step with how many are done, of all."""


def silent(done: int, total: int) -> None:
    """Say nothing of a solve's progress."""


@dataclass(frozen=True)
class MeshSize:
    """How fine a mesh is, by the contact that it is made for.

    The radius at which the indenter, at its deepest, cuts the rest membrane is `across` cells wide, or the gel's
    thickness, where that is smaller; there are `sectors` cells around half a circle. Beyond the path each ring of cells
    is `ring_growth` wider than the one before; each layer from the membrane, and from the backing, is `layer_growth`
    thicker. `stiffness` are a, b and c of `mesh_moduli`, calibrated for this mesh.
    """

    across: float
    sectors: int
    ring_growth: float
    layer_growth: float
    stiffness: tuple[float, float, float]

    @classmethod
    def of(cls, table: dict[str, Any]) -> Self:
        """Return the size that a table of `assets/fitted/meshes.toml` states."""
        return cls(**{**table, "stiffness": tuple(table["stiffness"])})

    def stiffness_excess(self, gel: Moduli, contact_width: float) -> float:
        """Return by what share a mesh of this size is stiffer than its gel, by ν and the contact's width.

        Linear tetrahedra are too stiff by a factor that hardly depends on depth, nor on the scene's size, since meshes
        scale with the contact. It grows with the bulk modulus, as what is left of volumetric locking does, and with
        each coarser ring of cells around a contact that is small beside the gel's thickness:
        (a + b / (1 − 2ν)) (1 − c ln w), w the contact's width in thicknesses. `benchmarks/physics/fit_meshes.py` fits
        them to locking-free solutions of the same energy, and checks them on scenes that were not used.
        """
        a, b, c = self.stiffness
        poisson_ratio = min(gel.poisson_ratio, LARGEST_POISSON_RATIO)
        return (a + b / (1 - 2 * poisson_ratio)) * max(0.0, 1 - c * math.log(contact_width))

    def widened(self, times: float) -> Self:
        """Return this mesh size with cells `times` as wide; a and b of `stiffness` grow in proportion to them."""
        a, b, c = self.stiffness
        return replace(self, across=self.across / times, stiffness=(a * times, b * times, c))


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


QUALITIES = {
    name: Quality(name, MeshSize.of(table["disc"]), MeshSize.of(table["pad"]), **table["steps"])
    for name, table in MESHES["qualities"].items()
}
# Along each axis, cells of half a disc under a body that is not convex: what would need more of them is not resolved.
_MOST_CELLS_ALONG = {name: table["most_cells_along"] for name, table in MESHES["qualities"].items()}


def _vector(values: Sequence[float]) -> Waypoint:
    """Return three floats; adding 0 turns −0, which would have another key, into 0."""
    x, y, z = (float(value) + 0.0 for value in values)
    return x, y, z


@dataclass(frozen=True)
class ContactProblem:
    """An indenter led through waypoints over a gel, in a frame with the contact point as its origin.

    `moduli` are the material's, for MuJoCo's energy. `pad_mm` is (x min, x max, y min, y max) of the pad around the
    contact point; None stands for a pad without edges, a disc whose rim is too far to matter. `waypoints_mm` are
    commanded displacements (x, y, z) of the indenter from touching the gel; a state is recorded at each. `parents` says
    for each from which waypoint it is reached, by its index, −1 for the undeformed gel: several drags can branch off
    one press. `turns_deg` are rotation vectors by which the indenter is turned about its origin at each waypoint; none
    if it never is. `static_friction` is larger than `friction`, None if they are equal. `relief` is the body whose
    recesses the indenter bridges, None if there are none.
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
    turns_deg: tuple[Waypoint, ...] = ()
    static_friction: float | None = None
    relief: AnyIndenter | None = None

    @classmethod
    def of(
        cls,
        scene: Scene,
        pad_mm: PadEdges | None,
        commands: Sequence[Sequence[float]],
        parents: Sequence[int],
    ) -> Self:
        """Return the problem of waypoints in a scene, at the modulus that elastomers share.

        A command is a displacement (x, y, z) in mm, and a rotation vector (x, y, z) in degrees if it turns.
        """
        if scene.quality not in QUALITIES:
            raise ValueError(unknown_name("quality", scene.quality, QUALITIES))
        turns = any(any(command[3:]) for command in commands)
        gel = scene.elastomer
        scale = _SHARED_MODULUS_MPA / gel.young_modulus_mpa if scene.sharing.modulus else 1.0
        mount, static = gel.mount_stiffness_n_per_mm, gel.static_friction
        problem = cls(
            moduli=gel.mujoco_moduli,
            friction=gel.friction,
            thickness_mm=gel.thickness_mm,
            # Every shape is a part of `AnyIndenter`.
            indenter=cast(AnyIndenter, scene.indenter_in_frame(edges=pad_mm is not None)),
            mount_stiffness_n_per_mm=None if mount is None else round(mount * scale, 9),
            pad_mm=pad_mm,
            waypoints_mm=tuple(_vector(command[:3]) for command in commands),
            parents=tuple(parents),
            quality=QUALITIES[scene.quality],
            turns_deg=tuple(_vector(command[3:]) for command in commands) if turns else (),
            static_friction=static if static is not None and static > gel.friction else None,
        )
        if problem.covers_pad and gel.poisson_ratio > LARGEST_POISSON_RATIO:
            raise ValueError(
                f"poisson_ratio = {gel.poisson_ratio:g}: under an indenter ({scene.indenter.label}) that covers "
                f"the pad the gel resists by its volume; must be at most {LARGEST_POISSON_RATIO:g}"
            )
        own = problem.moduli_of(gel)
        young_modulus_mpa = round(own.young_modulus_mpa * scale, 12)
        return replace(problem, moduli=replace(own, young_modulus_mpa=young_modulus_mpa))

    def moduli_of(self, gel: Elastomer) -> Moduli:
        """Return the moduli with which MuJoCo's energy acts as a gel's: equivalent ones, if the gel can rise beside."""
        return Moduli(gel.young_modulus_mpa, gel.poisson_ratio) if self.covers_pad else gel.mujoco_moduli

    @property
    def commands(self) -> Floats:
        """Displacement and turn at each waypoint, (n, 6)."""
        turns = self.turns_deg or np.zeros((len(self.waypoints_mm), 3))
        return np.hstack([np.array(self.waypoints_mm), np.array(turns)])

    def body_at(self, record: int) -> AnyIndenter:
        """Return the indenter as it is turned at a waypoint."""
        return self.indenter.turned(self.turns_deg[record]) if self.turns_deg else self.indenter

    def way(self, record: int) -> tuple[int, ...]:
        """Return the waypoints that the indenter comes through on its way to one, which is the last.

        A way begins anew where the indenter is lifted to depth 0.
        """
        parent = self.parents[record]
        return (*(self.way(parent) if parent >= 0 > self.waypoints_mm[record][2] else ()), record)

    def straight_down(self, record: int) -> int:
        """Return the last waypoint on the way to one before the indenter goes sideways or turns."""
        press, *others = self.way(record)
        for waypoint in others:
            if self.commands[waypoint, [0, 1, 3, 4, 5]].any():
                break
            press = waypoint
        return press

    @cached_property
    def stands(self) -> tuple[tuple[AnyIndenter, float], ...]:
        """The indenter as it is turned on its way, first as it starts, and how deep its lowest point goes at most."""
        bodies = {self.indenter: None}
        for start, end in self.segments[:, :, 3:] if self.turns_deg else ():
            steps = math.ceil(np.linalg.norm(end - start) / _CONTACT.turn_between_stands_deg)
            bodies |= dict.fromkeys(self.indenter.turned(turn) for turn in np.linspace(start, end, steps + 1))
        own_mm = self.indenter.origin_height_mm
        return tuple((body, self.depth_mm + (body.origin_height_mm - own_mm)) for body in bodies)

    @property
    def is_round(self) -> bool:
        """Whether what the indenter cuts of the rest membrane is always a disc around its axis, or nearly so."""
        return all(self._cuts_a_disc(body, depth_mm) for body, depth_mm in self.stands)

    def _cuts_a_disc(self, body: AnyIndenter, depth_mm: float) -> bool:
        least_mm = _CONTACT.round_share * body.penetration_radius_mm(depth_mm)
        is_disc = body.symmetry is Symmetry.REVOLUTION
        if body.convex and not is_disc:
            is_disc = body.contact_radius_mm(depth_mm) >= least_mm
        return is_disc and np.abs(self.cut_by(body, depth_mm)).min() >= least_mm

    @property
    def is_ring(self) -> bool:
        """Whether the contact is round, and hollow in the middle."""
        return self.is_round and self.meshed_radius_mm < _CONTACT.ring_share * min(self.half_cut_mm)

    @property
    def symmetric(self) -> bool:
        """Whether indenter, gel and waypoints are symmetric about y = 0, so that only y ≥ 0 is solved."""
        _, _, y_min, y_max = self.pad_mm or (0.0, 0.0, 0.0, 0.0)
        straight = y_max == -y_min and not self.commands[:, [1, 3, 5]].any()
        return straight and all(Symmetry.MIRROR_Y in body.symmetry for body, _ in self.stands)

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
        return max(body.penetration_radius_mm(depth_mm) for body, depth_mm in self.stands)

    def cut_by(self, body: AnyIndenter, depth_mm: float) -> Floats:
        """Return x and y, from and to (2, 2), of where a body cuts the undeformed membrane: all of a narrower pad."""
        cut_mm = body.cut_mm(depth_mm)
        if self.pad_mm is None:
            return cut_mm
        pad_mm = np.reshape(self.pad_mm, (2, 2))
        is_wider = np.ptp(cut_mm, axis=1, keepdims=True) > np.ptp(pad_mm, axis=1, keepdims=True)
        return np.where(is_wider, pad_mm, cut_mm)

    @property
    def cut_mm(self) -> Floats:
        """x and y, from and to (2, 2), of where the indenter, at its deepest, cuts the undeformed membrane."""
        cuts_mm = np.array([self.cut_by(body, depth_mm) for body, depth_mm in self.stands])
        return np.stack([cuts_mm[..., 0].min(axis=0), cuts_mm[..., 1].max(axis=0)], axis=1)

    @property
    def covers_pad(self) -> bool:
        """Whether the indenter, at its deepest, is wider than the pad along both sides."""
        return self.pad_mm is not None and np.array_equal(self.cut_mm.ravel(), self.pad_mm)

    @property
    def half_cut_mm(self) -> tuple[float, float]:
        """Half of how far, along x and y, the indenter at its deepest cuts the undeformed membrane."""
        half_x, half_y = np.maximum(np.ptp(self.cut_mm, axis=1) / 2, _CONTACT.smallest_contact_mm).tolist()
        return half_x, half_y

    @property
    def meshed_radius_mm(self) -> float:
        """The radius of the contact that the mesh is made for: half of its width, if it is longer than wide.

        Of a body that is not convex it is that of the widest patch, a ring's half width.
        """
        return min(self.half_cut_mm) if self.indenter.convex and not self.is_oblique else self.width_mm / 2

    @property
    def width_mm(self) -> float:
        """How wide the widest patch is, whatever way it lies."""
        return 2 * max(
            _CONTACT.smallest_contact_mm, *(body.contact_radius_mm(depth) for body, depth in self.stands)
        )

    @property
    def is_oblique(self) -> bool:
        """Whether a convex body's contact is long and lies across the mesh's lines, so that cells are smaller."""
        return self.narrowness < _CONTACT.oblique_share

    @property
    def narrowness(self) -> float:
        """How wide a convex body's contact is over the box around it along the mesh's lines; 1 along them."""
        return self.width_mm / (2 * min(self.half_cut_mm)) if self.indenter.convex else 1.0

    @property
    def contact_width(self) -> float:
        """How wide the contact is, cut from the rest membrane, in thicknesses of the gel."""
        return 2 * math.sqrt(math.prod(self.half_cut_mm)) / self.thickness_mm

    @property
    def widest_cell_mm(self) -> float:
        """How far apart the membrane's vertices are in a contact that is as wide as the gel is thick."""
        return _CONTACT.widest_contact_thicknesses * self.thickness_mm / self.mesh_size.across

    @property
    def cell_mm(self) -> float:
        """How far apart the membrane's vertices are where it is touched."""
        side_mm = min(self.half_cut_mm) if self.indenter.convex else self.meshed_radius_mm
        cell_mm = min(side_mm / self.mesh_size.across, self.widest_cell_mm)
        finest_mm = 2 * math.sqrt(math.prod(self.half_cut_mm)) / self.most_cells_along
        if self.indenter.convex:
            return min(cell_mm, _CONTACT.oblique_cell * finest_mm) if self.is_oblique else cell_mm
        return cell_mm if self.is_round else max(cell_mm, finest_mm)

    @property
    def most_cells_along(self) -> int:
        """How many cells there are at most along each axis under a body that is not convex; fewer of a whole pad."""
        share = self.mesh_size.across / QUALITIES[self.quality.name].disc.across
        return int(share * _MOST_CELLS_ALONG[self.quality.name] + 1e-9)

    def cell_along_mm(self, axis: int) -> float:
        """Return the same along x or y (axis 0, 1): a long contact is as many cells long as wide, or nearly so."""
        if self.is_oblique:
            return self.cell_mm
        along_mm = min(self.half_cut_mm[axis] / self.mesh_size.across, self.widest_cell_mm)
        return min(max(along_mm, self.cell_mm), _CONTACT.longest_cell * self.cell_mm)

    @property
    def stiffness_excess(self) -> float:
        """By what share the mesh is stiffer than the gel."""
        return self.mesh_size.stiffness_excess(self.moduli, self.contact_width)

    @property
    def mesh_moduli(self) -> Moduli:
        """The moduli with which the mesh acts as the gel; both in MuJoCo's energy."""
        young_mpa, poisson_ratio = self.moduli.young_modulus_mpa, self.moduli.poisson_ratio
        beyond = max(0.0, poisson_ratio - LARGEST_POISSON_RATIO)
        rise = 1 + MESHES["force_rise_per_poisson"] * beyond
        return Moduli(young_mpa * rise / (1 + self.stiffness_excess), poisson_ratio - beyond)

    @property
    def segments(self) -> Floats:
        """The straight segment (start, end) to each waypoint from its parent, in displacement and turn, (n, 2, 6)."""
        places = np.vstack([self.commands, np.zeros(6)])
        return np.stack([places[list(self.parents)], places[:-1]], axis=1)

    def arc_mm(self, turn_deg: Floats) -> float:
        """Return about how far a turn (3,) moves what touches the gel."""
        *roll, twist = np.radians(turn_deg)
        radius_mm = self.penetration_radius_mm if turn_deg.any() else 0.0
        lever_mm = math.hypot(radius_mm, self.indenter.origin_height_mm)
        return abs(twist) * radius_mm + math.hypot(*roll) * lever_mm

    def _step_scale(self, radius_mm: float) -> float:
        """Return how many times as long as the quality's load steps are, by thickness and the contact's radius.

        A scene that is larger by a factor is solved in the same number of steps.
        """
        larger = min(self.thickness_mm / _CONTACT.steps_thickness_mm, self.meshed_radius_mm / radius_mm)
        return max(1.0, larger)

    def steps(self, change: Floats) -> int:
        """Return in how many load steps the indenter moves and turns by a change (6,) of its command."""
        x, y, z = change[:3]
        travel_mm = math.hypot(x, y) + self.arc_mm(change[3:])
        press_step_mm = self.quality.press_step_mm * self._step_scale(_CONTACT.press_step_radius_mm)
        travel_step_mm = self.quality.travel_step_mm * self._step_scale(_CONTACT.travel_step_radius_mm)
        press_step_mm = min(press_step_mm, _CONTACT.longest_step_features * self.indenter.feature_size_mm)
        steps = max(abs(z) / press_step_mm, travel_mm / travel_step_mm)
        return max(1, math.ceil(steps - 1e-9))

    @property
    def load_steps(self) -> int:
        """The number of load steps through all waypoints, not counting halved ones."""
        return sum(self.steps(end - start) for start, end in self.segments)

    @property
    def key(self) -> str:
        """A hash of the physics and of the method that solves it."""
        shape = self.indenter.shape
        values = {"method": _METHOD_VERSION, "shape": shape, **asdict(self)}
        if not self.turns_deg:
            del values["turns_deg"]
        for name in ("static_friction", "relief"):
            if values[name] is None:
                del values[name]
        text = json.dumps(values, sort_keys=True, default=Indenter.model_dump)
        return hashlib.sha256(text.encode()).hexdigest()
