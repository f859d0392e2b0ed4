"""Quasi-static solution of a contact problem: load steps, each solved by Newton iterations, which are MuJoCo steps."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.audit import audit_contact
from gelgap.sim.extrapolation import GeometricSeries
from gelgap.sim.friction import FrictionalContacts
from gelgap.sim.material import mesh_moduli
from gelgap.sim.membrane import Diagnostics
from gelgap.sim.mesh.for_problem import mesh_for
from gelgap.sim.mujoco_model import GelModel, build_gel_model
from gelgap.sim.problem import ContactProblem
from gelgap.sim.solution import Record, Solution
from gelgap.sim.thresholds import THRESHOLDS

if TYPE_CHECKING:
    from gelgap.sim.contact_newton import ContactNewton

SolveProgress = Callable[[int, int], None]
"""Called at a solve's begin and after each load step with how many are done, of all."""


def silent(done: int, total: int) -> None:
    """Say nothing."""


@dataclass(frozen=True)
class State:
    """All that the next load step depends on; its arrays are replaced, never changed.

    `command_mm` (3,) is where the indenter's drive is, `active` (geoms,) which nodes the last iteration pressed,
    `slip_mm` (geoms,) how far each has slid since it touched, and `snapped` whether the contact ever has.
    """

    qpos: NDArray[np.float64]
    command_mm: NDArray[np.float64]
    active: NDArray[np.bool_]
    slip_mm: NDArray[np.float64]
    snapped: bool


class StaticNewton:
    """Gel and indenter on their way through load steps.

    `iterations` counts those since the last waypoint, `left_to_mujoco` those of all in which MuJoCo's solver did not
    take the solution of the condensed problem.
    """

    def __init__(self, gel: GelModel, problem: ContactProblem, *, condensed: bool = True) -> None:
        import mujoco

        self._mujoco = mujoco
        self.gel = gel
        self.problem = problem
        self.data = mujoco.MjData(gel.model)
        self.contacts = FrictionalContacts(gel, self.data, problem.indenter, problem.friction)
        self.command_mm = np.zeros(3)
        self.active = np.zeros(gel.model.ngeom, dtype=bool)
        self.slip_mm = np.zeros(gel.model.ngeom)
        self.snapped = False
        self.iterations = 0
        self.left_to_mujoco = 0
        self._rigid = problem.mount_stiffness_n_per_mm is None
        self._condensed = condensed
        self._contact_newton: ContactNewton | None = None

    def state(self) -> State:
        """Return the present state, to come back to."""
        qpos = np.array(self.data.qpos)
        return State(qpos, self.command_mm, self.active, self.slip_mm, self.snapped)

    def return_to(self, state: State) -> None:
        """Restore a state."""
        self.data.qpos[:] = state.qpos
        self.command_mm, self.active = state.command_mm, state.active
        self.slip_mm, self.snapped = state.slip_mm, state.snapped

    @property
    def indenter_force_n(self) -> NDArray[np.float64]:
        """Force (3,) of the indenter on the meshed gel."""
        return -np.array(self.data.qfrc_constraint[self.gel.indenter_dof])

    def vertices_mm(self) -> NDArray[np.float64]:
        """Return the present positions (n, 3) of the mesh's vertices."""
        self._mujoco.mj_kinematics(self.gel.model, self.data)
        self._mujoco.mj_flex(self.gel.model, self.data)
        return np.array(self.data.flexvert_xpos)

    def load_step(self, command_mm: NDArray[np.float64], most_iterations: int) -> tuple[bool, bool]:
        """Move the drive to a command (3,) and iterate to equilibrium, or until the iterations are spent.

        Returns whether equilibrium was reached, and whether a loaded node ran away.
        """
        data, quality = self.data, self.problem.quality
        start = self.state()
        displacement_mm, self.command_mm = command_mm - self.command_mm, command_mm
        tolerance = quality.travel_tolerance if displacement_mm[:2].any() else quality.press_tolerance
        furthest_mm = THRESHOLDS.extrapolation_share * self.problem.indenter.feature_size_mm
        if not self._rigid:
            self.gel.model.qpos_spring[self.gel.indenter_qpos] = command_mm
        self.contacts.begin_load_step()
        force, series, settled = np.full(3, np.inf), GeometricSeries(), False
        for iteration in range(most_iterations):
            if iteration > 0:
                active_dofs = self.gel.dofs(np.flatnonzero(self.active))
                data.qpos[:] += series.remainder(data.qvel, active_dofs, furthest_mm) * data.qvel
            gap_mm = self.iterate(displacement_mm if self._rigid and iteration == 0 else 0.0)
            if not np.all(np.isfinite(data.qpos)):
                return False, False
            last_force, force = force, self.indenter_force_n
            change = np.linalg.norm(force - last_force)
            settled = bool(
                iteration > 0
                and change <= tolerance * np.linalg.norm(force)
                and gap_mm <= THRESHOLDS.largest_gap_mm
                and self.contacts.at_rest()
                and self.contacts.coulomb_excess() <= THRESHOLDS.settled_coulomb_excess
            )
            if settled:
                break
        return settled, self._add_slip(start, float(np.linalg.norm(displacement_mm)))

    def iterate(self, indenter_step_mm: NDArray[np.float64] | float = 0.0) -> float:
        """Take one Newton iteration, a MuJoCo step of 1 s in which the indenter moves by a step (3,).

        Returns the largest distance from the indenter, mm, at which the iteration found nodes that it left with a
        force. Nodes that come near the indenter are constrained before they touch it, so that an iteration ends on its
        surface instead of finding the contact one iteration late. MuJoCo's solve starts from rest, which is nearer to
        its end than the last iteration's step.
        """
        mujoco, model, data = self._mujoco, self.gel.model, self.data
        data.qvel[:] = 0
        data.qvel[self.gel.indenter_dof] = indenter_step_mm
        mujoco.mj_fwdPosition(model, data)
        gap_mm = np.abs(data.contact.dist)
        if data.ncon:
            data.contact.includemargin[:] = 0
            self.contacts.impose_friction(self.active)
            mujoco.mj_makeConstraint(model, data)
        self._accelerate()
        data.qvel[:] += data.qacc
        data.qpos[:] += data.qvel
        if self._rigid:
            data.qpos[self.gel.indenter_qpos] = self.command_mm
        self.iterations += 1
        pushed = self.contacts.normal_force_n > 0
        self.active = np.zeros(model.ngeom, dtype=bool)
        self.active[self.contacts.nodes[pushed]] = True
        return float(gap_mm[pushed].max(initial=0.0))

    def _accelerate(self) -> None:
        """Let MuJoCo solve for the accelerations: it takes the solution of the condensed problem, or goes on itself."""
        data = self.data
        if data.ncon > 0 and self._condensed and self._start_solver():
            self._mujoco.mj_fwdConstraint(self.gel.model, data)
            if data.solver_niter[0] == 0 and np.array_equal(data.qacc, data.qacc_warmstart):
                return
        self.left_to_mujoco += 1
        self._set_up_solver(tolerance=0)

    def _start_solver(self) -> bool:
        """Start MuJoCo's solver at the solution of the condensed problem; return whether there is one.

        The tolerance is for the check of this start: the force that it leaves unbalanced.
        """
        from gelgap.sim.contact_newton import ContactNewton

        model, data = self.gel.model, self.data
        # With an endless tolerance the solver ends where it starts.
        self._set_up_solver(tolerance=np.inf)
        try:
            self._contact_newton = self._contact_newton or ContactNewton(self.gel, data)
            acceleration = self._contact_newton.acceleration()
        except np.linalg.LinAlgError:
            data.qacc_warmstart[:] = 0
            return False
        data.qacc_warmstart[:] = acceleration
        # MuJoCo would start from its estimate without contacts if that looked better, which it has not worked out here.
        data.qacc_smooth[:] = acceleration
        force_n = np.linalg.norm(data.efc_force) + np.linalg.norm(data.qfrc_smooth)
        model.opt.tolerance = THRESHOLDS.largest_gradient * force_n / (model.stat.meaninertia * model.nv)
        return True

    def _set_up_solver(self, tolerance: float) -> None:
        """Let MuJoCo set up its solver's problem, and solve it to a tolerance."""
        self.gel.model.opt.tolerance = tolerance
        self._mujoco.mj_forwardSkip(self.gel.model, self.data, self._mujoco.mjtStage.mjSTAGE_POS, 1)

    def _add_slip(self, start: State, moved_mm: float) -> bool:
        """Add what nodes that stayed in touch slid in the load step; return whether a loaded one ran away."""
        nodes, load = self.contacts.nodes, self.contacts.normal_force_n
        slid = np.zeros(self.data.nefc)
        if len(nodes):
            self._mujoco.mj_mulJacVec(self.gel.model, self.data, slid, self.data.qpos - start.qpos)
        stayed = (start.active & self.active)[nodes]
        slip_mm = np.where(stayed, np.linalg.norm(slid.reshape(-1, 3)[:, 1:], axis=1), 0.0)
        total_mm = self.slip_mm.copy()
        total_mm[nodes] += slip_mm
        self.slip_mm = np.where(self.active, total_mm, 0.0)
        away = slip_mm > THRESHOLDS.runaway_ratio * moved_mm
        self.snapped |= bool(load[away].sum() > THRESHOLDS.snapped_load_share * load.sum())
        return bool(away[self.contacts.loaded].any())


def solve(problem: ContactProblem, progress: SolveProgress = silent, *, condensed: bool = True) -> Solution:
    """Solve the problem from the undeformed gel.

    Unless it is `condensed`, MuJoCo does all of the linear algebra, which takes several times as long.
    """
    from gelgap.sim.contact_newton import one_thread

    with one_thread():
        return follow_waypoints(static_newton(problem, condensed=condensed), progress)


def static_newton(problem: ContactProblem, *, condensed: bool = True) -> StaticNewton:
    """Mesh the gel of a problem, undeformed and untouched."""
    mesh = mesh_for(problem)
    moduli = mesh_moduli(problem.moduli, problem.mesh_size.stiffness, problem.contact_width)
    return StaticNewton(build_gel_model(problem, mesh, moduli), problem, condensed=condensed)


def follow_waypoints(newton: StaticNewton, progress: SolveProgress = silent) -> Solution:
    """Lead the indenter from waypoint to waypoint."""
    problem, mesh = newton.problem, newton.gel.mesh
    done, total = 0, problem.load_steps
    progress(done, total)
    states = {-1: newton.state()}
    records = []
    for index, (waypoint, parent) in enumerate(zip(problem.waypoints_mm, problem.parents, strict=True)):
        if parent != index - 1:
            newton.return_to(states[parent])
        steps = problem.quality.load_steps(np.array(waypoint) - newton.command_mm)
        records.append(
            _move_to(newton, np.array(waypoint), lambda left, to=done + steps: progress(to - left, total))
        )
        done += steps
        if index in problem.parents[index + 2 :]:
            states[index] = newton.state()
    return Solution(problem, mesh.vertices_mm[mesh.surface, :2], tuple(records))


def _move_to(
    newton: StaticNewton, waypoint_mm: NDArray[np.float64], steps_left: Callable[[int], None]
) -> Record:
    """Lead the indenter to a waypoint in load steps along a straight line, and record the equilibrium there."""
    newton.iterations = 0
    settled = True
    commands_mm = _commands(newton, waypoint_mm)
    steps = newton.problem.quality.load_steps(waypoint_mm - newton.command_mm)
    for left in reversed(range(len(commands_mm))):
        settled = _advance(newton, commands_mm[-1 - left])
        # The smaller steps at first contact are part of the first load step.
        steps_left(min(left, steps))
    record = _record(newton, settled)
    for _ in range(THRESHOLDS.polishing_iterations):
        if not settled or record.diagnostics.coulomb_excess <= THRESHOLDS.largest_coulomb_excess:
            break
        newton.iterate()
        record = _record(newton, settled)
    return record


def _commands(newton: StaticNewton, waypoint_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the load steps' commands (n, 3) up to a waypoint, smaller steps at first contact."""
    displacement = waypoint_mm - newton.command_mm
    steps = newton.problem.quality.load_steps(displacement)
    shares = np.arange(1, steps + 1) / steps
    if not newton.active.any() and displacement[2] < 0:
        shares = np.concatenate([np.array(THRESHOLDS.first_contact_shares) / steps, shares])
    return newton.command_mm + displacement * shares[:, None]


def _advance(newton: StaticNewton, command_mm: NDArray[np.float64]) -> bool:
    """Take a load step, in halves if need be, and return whether equilibrium was reached."""
    start, middle_mm = newton.state(), 0.5 * (newton.command_mm + command_mm)
    settled, ran_away = newton.load_step(command_mm, THRESHOLDS.iterations_per_step)
    if settled and not ran_away:
        return True
    newton.return_to(start)
    newton.load_step(middle_mm, THRESHOLDS.iterations_per_half_step)
    settled, _ = newton.load_step(command_mm, THRESHOLDS.iterations_per_half_step)
    return settled


def _record(newton: StaticNewton, settled: bool) -> Record:
    """Record the present state: converged if it has settled, is sound by the audit, and the contact never snapped."""
    gel, problem, mesh = newton.gel, newton.problem, newton.gel.mesh
    vertices_mm = newton.vertices_mm()
    force = newton.indenter_force_n * (2.0 if mesh.symmetric else 1.0)
    if mesh.symmetric:
        force[1] = 0.0
    indenter_mm = np.array(newton.data.qpos[gel.indenter_qpos])
    finite = bool(np.isfinite(vertices_mm).all() and np.isfinite(force).all())
    diagnostics = Diagnostics(iterations=newton.iterations)
    if finite:
        origin_mm = indenter_mm + np.array([0.0, 0.0, problem.indenter.origin_height_mm])
        diagnostics = replace(
            audit_contact(mesh, vertices_mm, gel.moduli, problem.friction, problem.indenter, origin_mm),
            iterations=newton.iterations,
            sticking_fraction=newton.contacts.sticking_fraction(),
            slip_mm=float(newton.slip_mm.max()),
        )
    return Record(
        displacement_mm=(vertices_mm - mesh.vertices_mm)[mesh.surface].astype(np.float32),
        normal_force_n=newton.contacts.vertex_normal_force_n()[mesh.surface].astype(np.float32),
        indenter_mm=indenter_mm,
        force_n=force,
        converged=settled and finite and _is_sound(diagnostics) and not newton.snapped,
        diagnostics=diagnostics,
    )


def _is_sound(diagnostics: Diagnostics) -> bool:
    return (
        max(diagnostics.residual, diagnostics.imbalance, diagnostics.tension) < THRESHOLDS.largest_error
        and diagnostics.coulomb_excess <= THRESHOLDS.largest_coulomb_excess
        and diagnostics.min_volume_ratio > 0
    )
