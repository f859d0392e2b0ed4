"""Quasi-static solution of a contact problem: load steps, each solved by Newton iterations, which are MuJoCo steps."""

from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from gelgap.sim.audit import audit_contact
from gelgap.sim.contact import ContactNewton, FrictionalContacts
from gelgap.sim.cost import most_iterations
from gelgap.sim.fronts import elimination_groups
from gelgap.sim.indenter import Floats, Indenter, rotation
from gelgap.sim.mujoco_model import build_gel_model
from gelgap.sim.problem import ContactProblem, SolveProgress, silent
from gelgap.sim.solution import Record, Solution, SolveDiagnostics
from gelgap.sim.steady import solve_steadily

# The first load step onto the gel, in which every contact is new, stops at these shares of itself on its way.
_FIRST_CONTACT_SHARES = (0.2, 0.5)
# A load step that takes longer, loses the gel, or in which vertices run away, is undone and repeated in two halves, and
# these in halves if they fail as well; if a quarter fails, the way ends. A quarter may take twice as long: a vertex at
# the rim that sticks takes up to 70 iterations to let go.
_ITERATIONS_PER_STEP = 60
_MOST_HALVINGS = 2
# Vertices that carry force in equilibrium lie on the indenter to this distance.
_LARGEST_GAP_MM = 2e-3
# The tangent of an earlier iteration serves while each increment is at most this share of the one before: an iteration
# with it takes an eighth of the time. Since it converges more slowly, a load step that ends on one has to come nearer,
# by this share of its tolerance. A press at `standard` takes 0.6 to 0.7 of the time, forces to 1e-4.
_KEPT_TANGENT_RATIO = 0.7
_KEPT_TANGENT_TOLERANCE = 0.2
# An increment by a kept tangent that is longer than this many times the one before is undone, and found anew.
_LARGEST_KEPT_RATIO = 1.0
# Where a new tangent shortens the increment no more than that, friction is what settles slowly: the next slow
# increments are then taken with it, twice as many each time, each up to this many times as long as the one before. With
# that and acceleration a drag near full slip takes a third of the factorisations.
_MOST_PATIENCE, _LARGEST_PATIENT_RATIO = 8, 2.0
# MuJoCo's contact forces of a converged step exceed Coulomb's bound by no more than this share of it, at a waypoint and
# on the way there.
_CONVERGED_COULOMB_EXCESS, _PASSED_COULOMB_EXCESS = 5e-4, 5e-3
# Extrapolation moves no vertex further at a time than this share of the indenter's feature size, so that one that
# slowly slides off the indenter stays near it.
_EXTRAPOLATION_SHARE = 0.02
# A vertex runs away if it slides this many times as far as the indenter moves in a load step: near the limit of
# friction too long a step ends on another equilibrium than shorter ones agree on. It matters with this share of the
# load.
_RUNAWAY_RATIO, _RUNAWAY_LOAD_SHARE = 1.6, 0.05
# What a wide flat squeezes out slides this many times as far as it goes down, for each thickness of the gel that it is
# wide: 1.5 times a layer's mean.
_SQUEEZED_RATIO = 0.75
# If vertices with this share of the load run away all the same, the contact has snapped: where it comes to rest is
# dynamics, which statics does not determine.
_SNAPPED_LOAD_SHARE = 0.25
# MuJoCo accepts a solution that leaves at most this share of all forces unbalanced, beside what its own rounding and
# the solution's do.
_LARGEST_RESIDUAL = 1e-9
# A state is converged only if the audit's residual, imbalance and tension are below `_LARGEST_ERROR` and its Coulomb
# excess is at most `_LARGEST_COULOMB_EXCESS`; one whose load step converged gets up to this many further iterations.
_LARGEST_ERROR = 1e-2
_LARGEST_COULOMB_EXCESS = 1e-3
_POLISHING_ITERATIONS = 40

# How many increments acceleration remembers, and which of their combinations are noise.
_REMEMBERED, _SMALLEST_SINGULAR_VALUE = 5, 1e-6
# Under high friction a vertex at the rim lets go by increments that each grow by 4 %. After `_DRIFTED` of them in a
# row that keep their direction (cosine above `_ALONG`) the state leaps ahead, by `_LEAP_SHARE` of the most that
# extrapolation may move: a drag without slip at `standard` takes 0.46 of the time, and converges to its end.
_DRIFTED, _ALONG, _LEAP_SHARE = 3, 0.9, 0.5


def solve(problem: ContactProblem, progress: SolveProgress = silent) -> Solution:
    """Solve the problem from the undeformed gel."""
    # Several threads would wait for one another at hundreds of small matrices.
    with threadpool_limits(limits=1, user_api="blas"):
        return solve_steadily(problem, lambda own, told: StaticNewton(own).follow_waypoints(told), progress)


@dataclass(frozen=True)
class State:
    """All that the next load step depends on; its arrays are replaced, never changed.

    `command` (6,) is where the indenter's drive is, in mm, and its rotation vector in degrees, both from touching the
    gel, `active` (geoms,) which nodes the last iteration pressed,
    `slip_mm` (geoms,) how far each has slid since it touched, and `snapped` whether the contact ever has.
    """

    qpos: Floats
    command: Floats
    active: NDArray[np.bool_]
    slip_mm: Floats
    snapped: bool


class StaticNewton:
    """Gel and indenter of a problem on their way through load steps, from the undeformed and untouched gel on.

    `iterations` counts those since the last waypoint. MuJoCo only checks solutions of the condensed problem.
    """

    def __init__(self, problem: ContactProblem) -> None:
        self.problem = problem
        self.gel = gel = build_gel_model(problem)
        self.data = mujoco.MjData(gel.model)
        self.contacts = FrictionalContacts(gel, self.data, problem)
        self.body: Indenter = problem.indenter
        self.command = np.zeros(6)
        self.active = np.zeros(gel.model.ngeom, dtype=bool)
        self.slip_mm = np.zeros(gel.model.ngeom)
        self.snapped = False
        self.iterations = 0
        self._most_iterations = most_iterations(problem)
        self._furthest_mm = _EXTRAPOLATION_SHARE * problem.indenter.feature_size_mm
        self._ran_away = False
        self._rigid = problem.mount_stiffness_n_per_mm is None
        self._contact_newton: ContactNewton | None = None
        # Whether the last iteration was MuJoCo's with the present tangent.
        self._accepted = False

    def follow_waypoints(self, progress: SolveProgress = silent) -> Solution:
        """Lead the indenter from waypoint to waypoint, in load steps along straight lines, and record each state.

        A way ends where a load step fails, inverts an element, or spends the last of `most_iterations`: the waypoints
        from there on have the last equilibrium as their state, unconverged.
        """
        problem, mesh = self.problem, self.gel.mesh
        done, total = 0, problem.load_steps
        progress(done, total)
        states, left = {-1: self.state()}, {-1: self._most_iterations}
        records: list[Record] = []
        for index, (command, parent) in enumerate(zip(problem.commands, problem.parents, strict=True)):
            if parent != index - 1:
                self.return_to(states[parent])
            self.iterations, self._most_iterations, self._ran_away = 0, left[parent], False
            start, change = self.command, command - self.command
            steps = problem.steps(change)
            shares = np.arange(1, steps + 1) / steps
            if command[2] == 0:
                # Out of contact the gel is as it was at first, whatever it went through: there is no way to follow.
                qpos = states[-1].qpos.copy()
                qpos[self.gel.indenter_dof] = command[:3]
                self.return_to(replace(states[-1], qpos=qpos, command=command))
                shares = shares[-1:]
            elif not self.active.any() and change[2] < 0:
                shares = np.concatenate([np.array(_FIRST_CONTACT_SHARES) / steps, shares])
            for number, share in enumerate(shares, start=1):
                converged = (
                    self._advance(start + change * share, passes=share < 1) and not self._is_inverted()
                )
                if not converged:
                    break
                # The smaller steps at first contact are part of the first load step.
                progress(done + max(0, number - len(shares) + steps), total)
            records.append(self._polished_record(converged))
            left[index] = max(0, left[parent] - self.iterations) if converged else 0
            done += steps
            if index in problem.parents[index + 2 :]:
                states[index] = self.state()
        return Solution(problem, (mesh.vertices_mm[mesh.surface, :2],), tuple(records))

    def _advance(self, command: Floats, *, passes: bool, halvings: int = _MOST_HALVINGS) -> bool:
        """Take a load step, in halves if need be, and return whether it converged; if not, it ends at what did.

        The indenter `passes` the command, or it is a waypoint.
        """
        start, middle = self.state(), 0.5 * (self.command + command)
        most = min(_ITERATIONS_PER_STEP * (1 if halvings else 2), self._most_iterations - self.iterations)
        ran_away = self._ran_away
        converged, self._ran_away = self.load_step(command, most, passes=passes)
        # What runs away in halves as well is not a matter of their length, nor is it in the next step.
        if converged and (ran_away or not self._ran_away or halvings < _MOST_HALVINGS):
            return True
        self.return_to(start)
        if halvings and self.iterations < self._most_iterations:
            there = self._advance(middle, passes=True, halvings=halvings - 1)
            return there and self._advance(command, passes=passes, halvings=halvings - 1)
        self.iterate()  # The forces of this state, to be recorded.
        return False

    def load_step(self, command: Floats, most_iterations: int, *, passes: bool = False) -> tuple[bool, bool]:
        """Move the drive to a command (6,) and iterate to equilibrium, or until the iterations are spent.

        Where it `passes` friction need not be as exact. Returns whether it converged, and whether nodes ran away.
        """
        data, quality = self.data, self.problem.quality
        start = self.state()
        change, self.command = command - self.command, command
        displacement_mm, moved_mm = change[:3], float(np.linalg.norm(change[:3]))
        turn = None
        if change[3:].any():
            turn = rotation(command[3:]) @ rotation(start.command[3:]).T
            moved_mm += self.problem.arc_mm(change[3:])
        squeezed_mm = _SQUEEZED_RATIO * self.problem.contact_width * abs(float(change[2]))
        is_travel = displacement_mm[:2].any() or turn is not None
        tolerance = quality.travel_tolerance if is_travel else quality.press_tolerance
        if not self._rigid:
            self.gel.model.qpos_spring[self.gel.indenter_dof] = command[:3]
        self.contacts.begin_load_step(self.slip_mm)
        force, acceleration, converged = np.full(3, np.inf), AndersonAcceleration(), False
        increment_mm, active = np.inf, self.active
        kept_tangent, patience, spare = False, 0, 0
        correction = np.zeros_like(data.qpos)
        # A step of a small body's size can throw the gel off its edges, though it does not go up.
        held = start.active.any() and command[2] <= start.command[2]
        largest_excess = _PASSED_COULOMB_EXCESS if passes else _CONVERGED_COULOMB_EXCESS
        motion: tuple[Any, ...] = (displacement_mm if self._rigid else 0.0, turn)
        for iteration in range(most_iterations):
            if iteration > 0:
                data.qpos[:] += correction
            before = np.array(data.qpos)
            gap_mm = self.iterate(*motion, kept_tangent=kept_tangent)
            motion = ()
            largest_mm = (_LARGEST_PATIENT_RATIO if spare else _LARGEST_KEPT_RATIO) * increment_mm
            if not self._accepted and not np.linalg.norm(data.qvel) <= largest_mm:
                data.qpos[:] = before
                self.active = active
                self.contacts.forget_landing()
                gap_mm = self.iterate()
            active = self.active
            lost = held and not active.any()
            if lost or not np.all(np.isfinite(data.qpos)):
                return False, False
            last_mm, increment_mm = increment_mm, float(np.linalg.norm(data.qvel))
            fast = increment_mm <= _KEPT_TANGENT_RATIO * last_mm
            if self._accepted:
                patience = 0 if fast else min(max(2, 2 * patience), _MOST_PATIENCE)
                spare = patience
            elif not fast:
                spare = max(0, spare - 1)
            kept_tangent = fast or spare > 0
            last_force, force = force, self.indenter_force_n
            nearness = tolerance if self._accepted else _KEPT_TANGENT_TOLERANCE * tolerance
            change = np.linalg.norm(force - last_force)
            converged = bool(
                iteration > 0
                and change <= nearness * np.linalg.norm(force)
                and gap_mm <= _LARGEST_GAP_MM
                and self.contacts.at_rest()
                and self.contacts.coulomb_excess() <= largest_excess
            )
            if converged:
                break
            # The first increment is the load step's own.
            if iteration > 0:
                correction = acceleration.correction(data.qpos, data.qvel, self._furthest_mm)
        return converged, self._add_slip(start, max(_RUNAWAY_RATIO * moved_mm, squeezed_mm), turn)

    def iterate(
        self,
        indenter_step_mm: Floats | float = 0.0,
        turn: Floats | None = None,
        *,
        kept_tangent: bool = False,
    ) -> float:
        """Take one Newton iteration, a MuJoCo step of 1 s in which the indenter moves by a step (3,) and turns (3, 3).

        The increment of positions is then the velocity. Returns the largest distance from the indenter, mm, at which
        the iteration found nodes that it left with a force. Nodes that come near the indenter are constrained before
        they touch it, so that an iteration ends on its surface instead of finding the contact one iteration late.
        MuJoCo's solve starts from rest, which is nearer to its end than the last increment. With a `kept_tangent`
        stiffness and factor are those of the last iteration without, if there is one, and MuJoCo is not asked.
        """
        model, data = self.gel.model, self.data
        data.qvel[:] = 0
        data.qvel[self.gel.indenter_dof] = indenter_step_mm
        kept_tangent = kept_tangent and self._contact_newton is not None and self._find_contacts()
        if not kept_tangent:
            mujoco.mj_fwdPosition(model, data)
        if data.ncon:
            self.contacts.place()
        gap_mm = np.abs(data.contact.dist)
        if data.ncon:
            data.contact.includemargin[:] = 0
            self.contacts.impose_friction(self.active, turn)
            mujoco.mj_makeConstraint(model, data)
        self._accelerate(kept_tangent=kept_tangent)
        self._accepted = not kept_tangent
        data.qvel[:] += data.qacc
        data.qpos[:] += data.qvel
        if self._rigid:
            data.qpos[self.gel.indenter_dof] = self.command[:3]
        if turn is not None:
            self._turn(turn)
        self.iterations += 1
        pushed = self.contacts.normal_force_n > 0
        self.active = np.zeros(model.ngeom, dtype=bool)
        self.active[self.contacts.nodes[pushed]] = True
        return float(gap_mm[pushed].max(initial=0.0))

    def _turn(self, turn: Floats) -> None:
        """Have the indenter stand as the command says, turned by a matrix (3, 3) from where it stood."""
        self.body = self.problem.indenter.turned(self.command[3:])
        self.contacts.turn(turn, self.body)

    def _find_contacts(self) -> bool:
        """Have MuJoCo find the contacts but not the stiffness; return whether there are any."""
        for find in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_flex, mujoco.mj_collision):
            find(self.gel.model, self.data)
        return self.data.ncon > 0

    def _accelerate(self, *, kept_tangent: bool) -> None:
        """Set the accelerations to the solution of the condensed problem; NaN if there is none that MuJoCo accepts.

        Of a `kept_tangent` there is a factor, and MuJoCo is not asked.
        """
        model, data = self.gel.model, self.data
        # MuJoCo sets up its solver's problem; with an endless tolerance the solver ends where it starts.
        model.opt.tolerance = np.inf
        mujoco.mj_forwardSkip(model, data, mujoco.mjtStage.mjSTAGE_POS, 1)
        self.contacts.soften()
        if self._contact_newton is None:
            self._contact_newton = ContactNewton(self.gel, data, elimination_groups(self.problem))
        try:
            if not kept_tangent:
                self._contact_newton.factorise()
            acceleration = self._contact_newton.acceleration()
        except np.linalg.LinAlgError:
            data.qacc[:] = np.nan
            return
        data.qacc[:] = data.qacc_warmstart[:] = acceleration
        if kept_tangent:
            return
        # MuJoCo would start from its estimate without contacts if that looked better, which it has not worked out here.
        # The tolerance is for the check of this start: its residual, the unbalanced force.
        data.qacc_smooth[:] = acceleration
        force_n = np.linalg.norm(data.efc_force) + np.linalg.norm(data.qfrc_smooth)
        largest_n = _LARGEST_RESIDUAL * force_n + 2 * self._contact_newton.rounding_n
        model.opt.tolerance = largest_n / (model.stat.meaninertia * model.nv)
        mujoco.mj_fwdConstraint(model, data)
        if data.solver_niter[0] > 0 or not np.array_equal(data.qacc, acceleration):
            data.qacc[:] = np.nan

    def _add_slip(self, start: State, furthest_mm: float, turn: Floats | None) -> bool:
        """Add what nodes that stayed in touch slid in the load step; return whether loaded ones slid further."""
        nodes, load = self.contacts.nodes, self.contacts.normal_force_n
        slid = np.zeros(self.data.nefc)
        if len(nodes):
            mujoco.mj_mulJacVec(self.gel.model, self.data, slid, self.data.qpos - start.qpos)
        slid = slid.reshape(-1, 3)
        if turn is not None:
            slid = slid - self.contacts.carried_mm(turn)
        stayed = (start.active & self.active)[nodes]
        slip_mm = np.where(stayed, np.linalg.norm(slid[:, 1:], axis=1), 0.0)
        total_mm = self.slip_mm.copy()
        total_mm[nodes] += slip_mm
        self.slip_mm = np.where(self.active, total_mm, 0.0)
        away = slip_mm > furthest_mm
        away_share = load[away].sum() / max(load.sum(), 1e-300)
        self.snapped |= bool(away_share > _SNAPPED_LOAD_SHARE)
        return bool(away_share > _RUNAWAY_LOAD_SHARE)

    def state(self) -> State:
        """Return the present state, to come back to."""
        qpos = np.array(self.data.qpos)
        return State(qpos, self.command, self.active, self.slip_mm, self.snapped)

    def return_to(self, state: State) -> None:
        """Restore a state."""
        self.data.qpos[:] = state.qpos
        self.command, self.active = state.command, state.active
        self.slip_mm, self.snapped = state.slip_mm, state.snapped
        if not self._rigid:
            self.gel.model.qpos_spring[self.gel.indenter_dof] = self.command[:3]
        self._turn(np.eye(3))

    @property
    def indenter_force_n(self) -> Floats:
        """Force (3,) of the indenter on the meshed gel."""
        return -np.array(self.data.qfrc_constraint[self.gel.indenter_dof])

    def vertices_mm(self) -> Floats:
        """Return the present positions (n, 3) of the mesh's vertices."""
        mujoco.mj_kinematics(self.gel.model, self.data)
        mujoco.mj_flex(self.gel.model, self.data)
        return np.array(self.data.flexvert_xpos)

    def _is_inverted(self) -> bool:
        """Return whether a tetrahedron, which has a positive volume at rest, is turned inside out."""
        corners = self.vertices_mm()[self.gel.mesh.tetrahedra]
        return bool((np.linalg.det(corners[:, 1:] - corners[:, :1]) <= 0).any())

    def _polished_record(self, converged: bool) -> Record:
        """Record the present state, once MuJoCo has accepted it.

        A converged one that exceeds Coulomb's bound, or pulls on a vertex that a kept tangent left in contact, gets
        further iterations.
        """
        if converged and not self._accepted:
            self.iterate()
        record, acceleration = self._record(converged), AndersonAcceleration()
        for _ in range(_POLISHING_ITERATIONS):
            found = record.diagnostics
            within = found.coulomb_excess <= _LARGEST_COULOMB_EXCESS and found.tension < _LARGEST_ERROR
            if not converged or within:
                break
            self.data.qpos[:] += acceleration.correction(self.data.qpos, self.data.qvel, self._furthest_mm)
            self.iterate()
            record = self._record(converged)
        return record

    def _record(self, converged: bool) -> Record:
        """Record the present state: converged if it is sound by the audit as well, and the contact never snapped."""
        gel, problem, mesh = self.gel, self.problem, self.gel.mesh
        vertices_mm = self.vertices_mm()
        force = self.indenter_force_n * (2.0 if mesh.symmetric else 1.0)
        if mesh.symmetric:
            force[1] = 0.0
        indenter_mm = np.array(self.data.qpos[gel.indenter_dof])
        indenter_mm[2] += problem.indenter.origin_height_mm - self.body.origin_height_mm
        finite = bool(np.isfinite(vertices_mm).all() and np.isfinite(force).all())
        found = SolveDiagnostics(iterations=self.iterations)
        if finite:
            friction = self.contacts.vertex_friction()
            origin_mm = indenter_mm + np.array([0.0, 0.0, self.body.origin_height_mm])
            found = replace(
                audit_contact(mesh, vertices_mm, problem.mesh_moduli, friction, self.body, origin_mm),
                iterations=self.iterations,
                sticking_fraction=self.contacts.sticking_fraction(),
                slip_mm=float(self.slip_mm.max()),
            )
        sound = (
            max(found.residual, found.imbalance, found.tension) < _LARGEST_ERROR
            and found.coulomb_excess <= _LARGEST_COULOMB_EXCESS
            and found.min_volume_ratio > 0
        )
        normal_force_n, contact_force_n = (values[mesh.surface] for values in self.contacts.vertex_forces_n())
        torque = np.cross(vertices_mm[mesh.surface], contact_force_n).sum(axis=0)
        if mesh.symmetric:
            torque = np.array([0.0, 2 * torque[1], 0.0])
        return Record(
            displacement_mm=(vertices_mm - mesh.vertices_mm)[mesh.surface].astype(np.float32),
            normal_force_n=normal_force_n.astype(np.float32),
            contact_force_n=contact_force_n.astype(np.float32),
            indenter_mm=indenter_mm,
            force_n=force,
            torque_n_mm=torque,
            converged=converged and finite and sound and not self.snapped,
            diagnostics=found,
        )


class AndersonAcceleration:
    """Anderson's acceleration of an iteration x → x + f(x): the next x is where f is least by its last values.

    (Walker & Ni 2011, SIAM J. Numer. Anal. 49:1715). Friction alone settles by some 0.85 an iteration.
    """

    def __init__(self) -> None:
        self._places: list[Floats] = []
        self._increments: list[Floats] = []
        self._drifted = 0

    def correction(self, place: Floats, increment: Floats, furthest: float) -> Floats:
        """Add an increment f (n,) and where it has led (n,); return what to add to that, up to `furthest` each.

        A longer increment than the last one shows that the iteration has changed, or leads away from where it was: one
        that does so again and again, and straight on, is led further at once.
        """
        if self._increments:
            last, size = self._increments[-1], np.linalg.norm(increment)
            grows = size > np.linalg.norm(last)
            is_along = increment @ last > _ALONG * size * np.linalg.norm(last)
            self._drifted = self._drifted + 1 if grows and is_along else 0
            if grows:
                self._places, self._increments = [], []
        self._places = [*self._places, np.array(place)][-_REMEMBERED:]
        self._increments = [*self._increments, np.array(increment)][-_REMEMBERED:]
        if self._drifted >= _DRIFTED:
            return increment * _LEAP_SHARE * furthest / max(float(np.abs(increment).max()), 1e-300)
        # One change alone may be the gel's, which is not linear.
        if len(self._increments) < 3:
            return np.zeros_like(increment)
        changes = np.diff(np.column_stack(self._increments))
        shares, *_ = np.linalg.lstsq(changes, increment, rcond=_SMALLEST_SINGULAR_VALUE)
        correction = -np.diff(np.column_stack(self._places)) @ shares
        return correction * min(1.0, furthest / max(float(np.abs(correction).max()), 1e-300))
