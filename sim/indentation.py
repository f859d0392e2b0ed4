"""Quasi-static solution of a contact problem by MuJoCo: small load steps, each settled to equilibrium."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.audit import audit_contact
from gelgap.sim.extrapolation import GeometricSeries
from gelgap.sim.gel_model import GelModel, build_gel_model
from gelgap.sim.membrane import Diagnostics
from gelgap.sim.mesh import ordered_for_elimination
from gelgap.sim.mesh_stiffness import mesh_moduli
from gelgap.sim.problem import ContactProblem
from gelgap.sim.problem_mesh import mesh_for

_FRICTIONLESS = 1e-5
# A state is only called converged if residual, imbalance and tension of its diagnostics are below this,
_LARGEST_ERROR = 1e-2
# and coulomb_excess below this; up to so many iterations more are spent on a settled state to get there.
_LARGEST_COULOMB_EXCESS = 1e-3
_POLISHING = 40
# Load steps settle until MuJoCo's own contact forces, but for those below a share of the largest, obey Coulomb so well.
_SETTLED_COULOMB_EXCESS = 5e-4
_NEGLIGIBLE = 1e-2
_FIRST_STEPS = (0.2, 0.5)
# A load step that has not settled after so many iterations is taken in halves; a half is left as it is after so many.
_ITERATIONS_OF_A_STEP = 30
_ITERATIONS_OF_A_HALF = 60
# A settled node that carries force lies on the sphere to this, mm.
_AFLOAT_MM = 2e-3
# Iterations are extrapolated by at most this share of the sphere's radius.
_FURTHEST = 0.02
# A load step in which a loaded node slides so many times as far as the indenter goes is taken in halves.
_FAR = 1.6
# A contact has snapped if nodes that bear such a share of the load slide so far all the same.
_SNAPPED_SHARE = 0.25


@dataclass(frozen=True)
class Record:
    """Equilibrium at one waypoint: what the surface, the labels and the diagnostics are made from.

    `displacement_mm` (n, 3) belongs to the solution's surface vertices, `normal_force_n` (n,) is the normal contact
    force at each of them, `indenter_mm` (3,) the indenter's displacement from touching the gel, `force_n` (3,) its
    force on the gel.
    """

    displacement_mm: NDArray[np.float32]
    normal_force_n: NDArray[np.float32]
    indenter_mm: NDArray[np.float64]
    force_n: NDArray[np.float64]
    converged: bool
    diagnostics: Diagnostics


@dataclass(frozen=True, eq=False)
class Solution:
    """The records of a problem's waypoints on the vertices `rest_mm` (n, 2) of the outer membrane.

    A problem has one solution, so two solutions are equal if their problems are.
    """

    problem: ContactProblem
    rest_mm: NDArray[np.float64]
    records: tuple[Record, ...]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Solution) and self.problem == other.problem

    def __hash__(self) -> int:
        return hash(self.problem)


def solve(problem: ContactProblem) -> Solution:
    """Solve the problem from the undeformed gel."""
    zone = problem.sphere_radius_mm + problem.reach_mm + 0.4
    mesh = ordered_for_elimination(mesh_for(problem), problem.contact_mm, problem.ways_mm[:, :, :2])
    young_modulus_mpa, poisson_ratio = mesh_moduli(
        problem.young_modulus_mpa, problem.poisson_ratio, problem.mesh_size.stiffness
    )
    gel = build_gel_model(
        mesh,
        young_modulus_mpa=young_modulus_mpa,
        poisson_ratio=poisson_ratio,
        friction=problem.friction,
        sphere_radius_mm=problem.sphere_radius_mm,
        contact_zone_mm=zone,
        mount_stiffness_n_per_mm=problem.mount_stiffness_n_per_mm,
    )
    indentation = _Indentation(gel, problem)
    states = {-1: indentation.state()}
    records = []
    for index, (waypoint, parent) in enumerate(zip(problem.waypoints_mm, problem.parents, strict=True)):
        if parent != index - 1:
            indentation.return_to(states[parent])
        records.append(indentation.move_to(np.array(waypoint)))
        if index in problem.parents[index + 2 :]:
            states[index] = indentation.state()
    return Solution(problem=problem, rest_mm=mesh.vertices_mm[mesh.surface, :2], records=tuple(records))


@dataclass(frozen=True)
class _State:
    """All that the next load step depends on."""

    qpos: NDArray[np.float64]
    command: NDArray[np.float64]
    pressed: NDArray[np.bool_]
    slipped_mm: NDArray[np.float64]
    snapped: bool


class _Indentation:
    """The state of one indentation under way."""

    def __init__(self, gel: GelModel, problem: ContactProblem) -> None:
        import mujoco

        self._mujoco = mujoco
        self._gel = gel
        self._problem = problem
        self._data = mujoco.MjData(gel.model)
        self._command = np.zeros(3)
        self._iterations = 0
        self._sides = 2.0 if gel.mesh.half else 1.0
        self._slipped_mm = np.zeros(gel.model.ngeom)
        self._pressed = np.zeros(gel.model.ngeom, dtype=bool)
        self._held = np.zeros(gel.model.ngeom, dtype=bool)
        self._landed = np.zeros(gel.model.ngeom, dtype=bool)
        self._start_mm: NDArray[np.float64] | None = None
        self._anchor_mm = np.zeros((gel.model.ngeom, 3))
        self._snapped = False
        self._too_far = False
        # MuJoCo adds each contact's surface velocity to its friction rows only if some geom seems to have one.
        gel.model.flg_surfacevel = True

    def state(self) -> _State:
        """Return a copy of the present state, to come back to."""
        return _State(
            np.array(self._data.qpos),
            self._command.copy(),
            self._pressed.copy(),
            self._slipped_mm.copy(),
            self._snapped,
        )

    def return_to(self, state: _State) -> None:
        """Go back to a state as if nothing had happened since."""
        self._data.qpos[:] = state.qpos
        self._command = state.command.copy()
        self._pressed = state.pressed.copy()
        self._slipped_mm = state.slipped_mm.copy()
        self._snapped = state.snapped

    def move_to(self, target: NDArray[np.float64]) -> Record:
        """Lead the indenter to `target` in load steps along a straight line, and record the equilibrium there."""
        self._iterations = 0
        converged = True
        for command in self._load_steps(target):
            converged = self._advance(command)
        record = self._record(converged)
        for _ in range(_POLISHING):
            if not converged or record.diagnostics.coulomb_excess <= _LARGEST_COULOMB_EXCESS:
                break
            self._iterate()
            record = self._record(converged)
        return record

    def _load_steps(self, target: NDArray[np.float64]) -> NDArray[np.float64]:
        """Divide the way to `target` into steps, smaller ones at first contact, where all nodes are new to it."""
        way = target - self._command
        steps = self._problem.quality.load_steps(way)
        shares = np.arange(1, steps + 1) / steps
        if not self._pressed.any() and way[2] < 0:
            shares = np.concatenate([np.array(_FIRST_STEPS) / steps, shares])
        return self._command + way * shares[:, None]

    def _advance(self, command: NDArray[np.float64]) -> bool:
        """Take a load step, in halves if need be, and say whether equilibrium was reached.

        In a drag near the limit of friction too long a step goes in circles, or ends on another equilibrium than
        shorter ones agree on, with vertices further on than the indenter took them.
        """
        start, middle = self.state(), 0.5 * (self._command + command)
        if self._settle(command, _ITERATIONS_OF_A_STEP) and not self._too_far:
            return True
        self.return_to(start)
        self._settle(middle, _ITERATIONS_OF_A_HALF)
        return self._settle(command, _ITERATIONS_OF_A_HALF)

    def _settle(self, command: NDArray[np.float64], most_iterations: int) -> bool:
        """Iterate to equilibrium at the command, and say whether it was reached."""
        gel, data, quality = self._gel, self._data, self._problem.quality
        way, self._command = command - self._command, command
        tolerance = quality.shear_tolerance if way[:2].any() else quality.press_tolerance
        compliant = self._problem.mount_stiffness_n_per_mm is not None
        start = self.state()
        furthest_mm = _FURTHEST * self._problem.sphere_radius_mm
        travel_mm = float(np.linalg.norm(way))
        if compliant:
            gel.model.qpos_spring[gel.ball_qpos] = command
        self._start_mm = None
        force, series = np.full(3, np.inf), GeometricSeries()
        for iteration in range(most_iterations):
            if iteration > 0:
                data.qpos[:] += series.remainder(data.qvel, self._contact_dofs(), furthest_mm) * data.qvel
            afloat_mm = self._iterate(0.0 if compliant or iteration else way)
            if not np.all(np.isfinite(data.qpos)):
                return False
            new_force = -np.array(data.qfrc_constraint[gel.ball_dof])
            change = np.linalg.norm(new_force - force)
            force = new_force
            settled = change <= tolerance * np.linalg.norm(force) and afloat_mm <= _AFLOAT_MM
            settled = settled and (self._held & ~self._landed)[self._nodes()[self._loaded()]].all()
            if iteration > 0 and settled and self._coulomb_excess() <= _SETTLED_COULOMB_EXCESS:
                self._close_load_step(start, travel_mm)
                return True
        self._close_load_step(start, travel_mm)
        return False

    def _close_load_step(self, start: _State, travel_mm: float) -> None:
        """Note how far nodes that stayed in touch slid in the load step: too far, or did the contact snap?"""
        nodes = self._nodes()
        stayed = start.pressed & self._pressed
        self._too_far = False
        if len(nodes):
            moved = np.zeros(self._data.nefc)
            self._mujoco.mj_mulJacVec(self._gel.model, self._data, moved, self._data.qpos - start.qpos)
            slip = np.where(stayed[nodes], np.linalg.norm(moved.reshape(-1, 3)[:, 1:], axis=1), 0.0)
            self._slipped_mm[nodes] += slip
            far, normal = slip > _FAR * travel_mm, self._normal_force_rows()
            self._too_far = bool(far[self._loaded()].any())
            self._snapped |= bool(normal[far].sum() > _SNAPPED_SHARE * normal.sum())
        self._slipped_mm[~self._pressed] = 0.0

    def _iterate(self, way_mm: NDArray[np.float64] | float = 0.0) -> float:
        """Take one Newton iteration of the static problem, a MuJoCo step of 1 s in which the ball goes `way_mm`.

        Returns how far off the sphere the iteration found nodes that it left with a force, mm.

        Nodes that come near the ball are constrained before they touch it, so that an iteration ends on the surface
        of the ball instead of finding the contact one iteration late; a node is free to slide until it has landed.
        MuJoCo's solve starts from rest, which is nearer to its end than the last iteration's step.
        """
        mujoco, model, data = self._mujoco, self._gel.model, self._data
        data.qvel[:] = 0
        data.qvel[self._gel.ball_dof] = way_mm
        mujoco.mj_fwdPosition(model, data)
        height_mm = np.zeros(0)
        if data.ncon:
            nodes = self._nodes()
            height_mm = np.array(data.contact.dist)
            data.contact.includemargin[:] = 0
            self._remember_slip(nodes)
            data.contact.friction[~self._held[nodes], :2] = _FRICTIONLESS
            mujoco.mj_makeConstraint(model, data)
        mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_POS, 1)
        data.qvel[:] += data.qacc
        data.qpos[:] += data.qvel
        if self._problem.mount_stiffness_n_per_mm is None:
            data.qpos[self._gel.ball_qpos] = self._command
        self._iterations += 1
        self._pressed[:] = False
        if data.ncon:
            self._pressed[nodes] = self._normal_force_rows() > 0
        return float(np.abs(height_mm[self._normal_force_rows() > 0]).max(initial=0.0))

    def _remember_slip(self, nodes: NDArray[np.int64]) -> None:
        """Make friction act against the slip since the load step's start, or since the node landed in it.

        Coulomb's law of a load step (backward Euler) is about this slip and not that of one iteration. A contact's
        surface velocity is added to its friction rows; as an iteration takes 1 s, it stands for what has slid already.
        MuJoCo's convex friction cone lets a node that slides by s rise by μ s (Anitescu 2006, Math. Program. 105:113).
        The gap is widened by as much, so that a settled node slides on the sphere (the fixed point of De Saxcé & Feng
        1998, Math. Comput. Model. 28:225).

        A node that lands within the load step does so, on average, half way: its slip counts from half way between
        where it was at the start and where it slid to freely.
        """
        data = self._data
        place_mm = data.geom_xpos - data.geom_xpos[self._gel.ball_geom]
        if self._start_mm is None:
            self._start_mm, self._anchor_mm, self._held = place_mm, place_mm.copy(), self._pressed.copy()
        self._landed = self._pressed & ~self._held
        self._anchor_mm[self._landed] = (self._start_mm + place_mm)[self._landed] / 2
        self._held |= self._landed
        tangents = data.contact.frame.reshape(-1, 3, 3)[:, 1:]
        slip_mm = np.einsum("nij,nj->ni", tangents, (place_mm - self._anchor_mm)[nodes])
        slip_mm[~self._held[nodes]] = 0.0
        data.contact.surfacevel[:, :2] = slip_mm
        # Most nodes that landed go back and stick; they would be pressed into the sphere by a widened gap.
        slides = np.where(self._landed[nodes], 0.0, np.linalg.norm(slip_mm, axis=1))
        data.contact.dist[:] += self._problem.friction * slides

    def _coulomb_excess(self) -> float:
        """Return the largest |f_t| / (μ f_n) − 1 of contacts that bear more than a negligible share of the load.

        Friction was bounded along the normals that the last iteration began with; where nodes have gone on, normals
        have turned.
        """
        data, friction = self._data, self._problem.friction
        loaded = self._loaded()
        if not loaded.any() or friction == 0:
            return -1.0
        nodes = self._nodes()[loaded]
        moved = data.qvel[self._dofs(nodes)].reshape(-1, 3) - data.qvel[self._gel.ball_dof]
        normal = data.geom_xpos[nodes] - data.geom_xpos[self._gel.ball_geom] + moved
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        rows = data.efc_force[: 3 * data.ncon].reshape(-1, 3)[loaded]
        force = np.einsum("ni,nij->nj", rows, data.contact.frame.reshape(-1, 3, 3)[loaded])
        push = np.einsum("ni,ni->n", force, normal)
        drag = np.linalg.norm(force - push[:, None] * normal, axis=1)
        return float((drag / (friction * push)).max()) - 1

    def _nodes(self) -> NDArray[np.int64]:
        """Return each contact's node geom."""
        geoms = self._data.contact.geom
        return np.where(geoms[:, 0] == self._gel.ball_geom, geoms[:, 1], geoms[:, 0])

    def _loaded(self) -> NDArray[np.bool_]:
        """Return which contacts bear more than a negligible share of the strongest's normal force."""
        normal = self._normal_force_rows()
        return normal > _NEGLIGIBLE * normal.max(initial=0.0)

    def _contact_dofs(self) -> NDArray[np.int64]:
        """Return the dofs of the nodes that the last iteration pressed against the ball."""
        return self._dofs(np.flatnonzero(self._pressed))

    def _dofs(self, nodes: NDArray[np.int64]) -> NDArray[np.int64]:
        vertices = self._gel.vertex_of_geom[nodes]
        return (self._gel.vertex_dof[vertices][:, None] + np.arange(3)).ravel()

    def _normal_force_rows(self) -> NDArray[np.float64]:
        return self._data.efc_force[0 : 3 * self._data.ncon : 3]

    def _record(self, settled: bool) -> Record:
        gel, data, problem = self._gel, self._data, self._problem
        surface, rest = gel.mesh.surface, gel.mesh.vertices_mm
        self._mujoco.mj_kinematics(gel.model, data)
        self._mujoco.mj_flex(gel.model, data)
        positions = np.array(data.flexvert_xpos)
        force = -np.array(data.qfrc_constraint[gel.ball_dof]) * self._sides
        if gel.mesh.half:
            force[1] = 0.0
        indenter = np.array(data.qpos[gel.ball_qpos])
        finite = bool(np.isfinite(positions).all() and np.isfinite(force).all())
        diagnostics = Diagnostics(iterations=self._iterations)
        if finite:
            audit = audit_contact(
                gel.mesh,
                positions,
                young_modulus_mpa=gel.young_modulus_mpa,
                poisson_ratio=gel.poisson_ratio,
                friction=problem.friction,
                centre_mm=indenter + np.array([0.0, 0.0, problem.sphere_radius_mm]),
                radius_mm=problem.sphere_radius_mm,
            )
            diagnostics = Diagnostics(
                residual=audit.residual,
                iterations=self._iterations,
                sticking_fraction=self._sticking_fraction(),
                slip_mm=float(self._slipped_mm.max()),
                elastic_energy_mj=audit.elastic_energy_mj,
                min_volume_ratio=audit.min_volume_ratio,
                imbalance=audit.imbalance,
                coulomb_excess=audit.coulomb_excess,
                tension=audit.tension,
            )
        worst = max(diagnostics.residual, diagnostics.imbalance, diagnostics.tension)
        sound = finite and worst < _LARGEST_ERROR and diagnostics.min_volume_ratio > 0
        sound = sound and diagnostics.coulomb_excess <= _LARGEST_COULOMB_EXCESS
        return Record(
            displacement_mm=(positions - rest)[surface].astype(np.float32),
            normal_force_n=self._normal_forces()[surface].astype(np.float32),
            indenter_mm=indenter,
            force_n=force,
            converged=settled and sound and not self._snapped,
            diagnostics=diagnostics,
        )

    def _sticking_fraction(self) -> float:
        """Return the share of the normal force on nodes whose friction is below its limit."""
        rows = self._data.efc_force[: 3 * self._data.ncon].reshape(-1, 3)
        normal = rows[:, 0]
        if not normal.sum() > 0:
            return 1.0
        sticks = np.linalg.norm(rows[:, 1:], axis=1) < 0.99 * self._problem.friction * normal
        return float(1.0 - normal[~sticks].sum() / normal.sum())

    def _normal_forces(self) -> NDArray[np.float64]:
        forces = np.zeros(len(self._gel.mesh.vertices_mm))
        forces[self._gel.vertex_of_geom[self._nodes()]] = self._normal_force_rows()
        return forces
