"""Quasi-static solution of a contact problem: load steps, each solved by Newton iterations, which are MuJoCo steps."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from gelgap.sim.audit import audit_contact
from gelgap.sim.contact import ContactNewton, FrictionalContacts
from gelgap.sim.cost import most_iterations
from gelgap.sim.indenter import Floats, Indenter, rotation
from gelgap.sim.mesh import elimination_groups
from gelgap.sim.mujoco_model import build_gel_model
from gelgap.sim.problem import ContactProblem, SolveProgress, silent
from gelgap.sim.solution import Record, Solution, SolveDiagnostics
from gelgap.sim.steady import solve_steadily


@dataclass(frozen=True)
class Policy:
    """What was tuned in the solve of a load step. Lengths are mm; counts, ratios and shares have no unit.

    `python -m gelgap.benchmarks.physics.policy` prints run time and error without each of the three pieces.
    """

    # Of `Linearisation`.
    kept_tangent_ratio: float = 0.7
    """An earlier iteration's tangent serves while each increment is at most this share of the one before."""
    kept_tangent_tolerance: float = 0.2
    """A load step that ends on a kept tangent, which converges slowly, has this share of its tolerance."""
    largest_kept_ratio: float = 1.0
    """An increment by a kept tangent that exceeds the one before by this factor is undone and found anew."""
    most_patience: int = 8
    """Where a new tangent helps no more, slow increments keep it: twice as many each time, up to this many."""
    largest_patient_ratio: float = 2.0
    """Each of these may be at most this many times as long as the one before."""

    # Of `AndersonAcceleration`.
    remembered: int = 5
    """Increments that are combined; with fewer than 3 none are."""
    smallest_singular_value: float = 1e-6
    """Combinations of increments below this share of the largest are noise."""
    extrapolation_share: float = 0.02
    """Of the indenter's feature size: the most that a vertex is moved, so that one that slides off stays near it."""
    drifted: int = 3
    """The state leaps ahead after this many increments in a row that grow and keep their direction."""
    along: float = 0.9
    """The least cosine between two increments of one direction."""
    leap_share: float = 0.5
    """A leap's length, as a share of the most that a vertex may be moved."""

    # Of `StepControl`.
    first_contact_shares: tuple[float, ...] = (0.2, 0.5)
    """The first load step onto the gel, in which every contact is new, stops at these shares of itself."""
    iterations_per_step: int = 60
    """A load step that takes more fails; its smallest part, twice as many: at the rim a vertex lets go in up to 70."""
    most_halvings: int = 2
    """A load step that fails is repeated in two halves, so often; if the smallest part fails, the way ends."""
    runaway_ratio: float = 1.6
    """A vertex that slides this many times as far as the indenter moves in a load step has run away: the step was too
    long, and ends on another equilibrium than shorter ones agree on."""
    squeezed_ratio: float = 0.75
    """A wide flat squeezes out gel by this many times its way down, for each thickness it is wide; half is the mean."""
    runaway_load_share: float = 0.05
    """A load step in which vertices with more than this share of the load run away is repeated in halves."""
    snapped_load_share: float = 0.25
    """Above this share the contact has snapped: where it comes to rest is dynamics, which statics does not say."""

    # When a load step has settled, and a state is converged.
    largest_gap_mm: float = 2e-3
    """Vertices that carry force in equilibrium lie on the indenter to this distance."""
    settled_coulomb_excess: float = 5e-4
    """Contact forces exceed Coulomb's bound by no more than this share of it at a waypoint,"""
    passed_coulomb_excess: float = 5e-3
    """and by no more than this on the way there."""
    largest_residual: float = 1e-9
    """MuJoCo accepts a solution that leaves at most this share of all forces unbalanced, beside rounding errors."""
    largest_error: float = 1e-2
    """A state is converged only if the audit's residual, imbalance and tension are below this share,"""
    largest_coulomb_excess: float = 1e-3
    """and its Coulomb excess is at most this."""
    polishing_iterations: int = 40
    """One whose load step settled gets up to this many further iterations to reach these two."""


POLICY = Policy()


def solve(problem: ContactProblem, progress: SolveProgress = silent) -> Solution:
    """Solve the problem from the undeformed gel."""
    # Several threads would wait for one another at hundreds of small matrices.
    with threadpool_limits(limits=1, user_api="blas"):
        return solve_steadily(problem, solve_whole, progress)


def solve_whole(problem: ContactProblem, progress: SolveProgress = silent) -> Solution:
    """Solve the problem from the undeformed gel, all of its slides to their ends."""
    return StaticNewton(problem).follow_waypoints(progress)


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

    def __init__(self, problem: ContactProblem, policy: Policy = POLICY) -> None:
        self.problem = problem
        self.policy = policy
        self.gel = build_gel_model(problem)
        self.data = mujoco.MjData(self.gel.model)
        self.contacts = FrictionalContacts(self.gel, self.data, problem)
        self.body: Indenter = problem.indenter
        self.command = np.zeros(6)
        self.active = np.zeros(self.gel.model.ngeom, dtype=bool)
        self.slip_mm = np.zeros(self.gel.model.ngeom)
        self.snapped = False
        self.iterations = 0
        self._steps = StepControl(problem, policy)
        self._most_iterations = most_iterations(problem)
        self._furthest_mm = policy.extrapolation_share * problem.indenter.feature_size_mm
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
        states = {-1: self.state()}
        iterations_left = {-1: self._most_iterations}
        records: list[Record] = []
        for index, (command, parent) in enumerate(zip(problem.commands, problem.parents, strict=True)):
            if parent != index - 1:
                self.return_to(states[parent])
            self.iterations = 0
            self._most_iterations = iterations_left[parent]
            self._ran_away = False
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
                shares = self._steps.at_first_contact(shares)
            for number, share in enumerate(shares, start=1):
                converged = (
                    self._advance(start + change * share, passes=share < 1) and not self._is_inverted()
                )
                if not converged:
                    break
                # The smaller steps at first contact are part of the first load step.
                progress(done + max(0, number - len(shares) + steps), total)
            records.append(self._polished_record(converged))
            left = max(0, iterations_left[parent] - self.iterations)
            iterations_left[index] = left if converged else 0
            done += steps
            if index in problem.parents[index + 2 :]:
                states[index] = self.state()
        return Solution(problem, (mesh.vertices_mm[mesh.surface, :2],), tuple(records))

    def _advance(self, command: Floats, *, passes: bool, halvings: int = 0) -> bool:
        """Take a load step, in halves if need be, and return whether it converged; if not, it ends at what did.

        The indenter `passes` the command, or it is a waypoint. The load step is a whole one halved `halvings` times.
        """
        start = self.state()
        middle = 0.5 * (self.command + command)
        most = self._steps.most_iterations(halvings, self._most_iterations - self.iterations)
        ran_away_before = self._ran_away
        converged, self._ran_away = self.load_step(command, most, passes=passes)
        # What runs away in halves as well is not a matter of their length, nor is it in the next step.
        if converged and (ran_away_before or not self._ran_away or halvings):
            return True
        self.return_to(start)
        if halvings < self.policy.most_halvings and self.iterations < self._most_iterations:
            halfway = self._advance(middle, passes=True, halvings=halvings + 1)
            return halfway and self._advance(command, passes=passes, halvings=halvings + 1)
        self.iterate()  # The forces of this state, to be recorded.
        return False

    def load_step(self, command: Floats, most_iterations: int, *, passes: bool = False) -> tuple[bool, bool]:
        """Move the drive to a command (6,) and iterate to equilibrium, or until the iterations are spent.

        Where it `passes` friction need not be as exact. Returns whether it converged, and whether nodes ran away.
        """
        data = self.data
        start = self.state()
        step = command - self.command
        self.command = command
        turn = rotation(command[3:]) @ rotation(start.command[3:]).T if step[3:].any() else None
        if not self._rigid:
            self.gel.model.qpos_spring[self.gel.indenter_dof] = command[:3]
        self.contacts.begin_load_step(self.slip_mm)
        linearisation = Linearisation(self.policy)
        acceleration = AndersonAcceleration(self.policy)
        correction = np.zeros_like(data.qpos)
        # A step of a small body's size can throw the gel off its edges, though it does not go up.
        held = start.active.any() and command[2] <= start.command[2]
        converged, force_n = False, np.full(3, np.inf)
        for iteration in range(most_iterations):
            if iteration == 0:
                gap_mm = self._iterate_by(linearisation, step[:3] if self._rigid else 0.0, turn)
            else:
                data.qpos[:] += correction
                gap_mm = self._iterate_by(linearisation)
            lost = held and not self.active.any()
            if lost or not np.all(np.isfinite(data.qpos)):
                return False, False
            last_force_n, force_n = force_n, self.indenter_force_n
            if iteration > 0:
                tolerance = self._steps.tolerance(step, kept_tangent=not self._accepted)
                converged = self._is_settled(force_n - last_force_n, tolerance, gap_mm, passes=passes)
                if converged:
                    break
                # The first increment is the load step's own.
                correction = acceleration.correction(data.qpos, data.qvel, self._furthest_mm)
        return converged, self._add_slip(start, self._steps.furthest_slip_mm(step), turn)

    def _iterate_by(
        self, linearisation: "Linearisation", step_mm: Floats | float = 0.0, turn: Floats | None = None
    ) -> float:
        """Iterate as the linearisation says, anew if a kept tangent leads too far; return what `iterate` does."""
        before, active = np.array(self.data.qpos), self.active
        gap_mm = self.iterate(step_mm, turn, kept_tangent=linearisation.keeps)
        increment_mm = float(np.linalg.norm(self.data.qvel))
        if not self._accepted and linearisation.is_too_long(increment_mm):
            self.data.qpos[:] = before
            self.active = active
            self.contacts.forget_landing()
            gap_mm = self.iterate()
            increment_mm = float(np.linalg.norm(self.data.qvel))
        linearisation.follow(increment_mm, is_new=self._accepted)
        return gap_mm

    def _is_settled(self, change_n: Floats, tolerance: float, gap_mm: float, *, passes: bool) -> bool:
        """Return whether an iteration that changed the force by (3,) and found that gap ends the load step."""
        policy = self.policy
        largest_excess = policy.passed_coulomb_excess if passes else policy.settled_coulomb_excess
        return bool(
            np.linalg.norm(change_n) <= tolerance * np.linalg.norm(self.indenter_force_n)
            and gap_mm <= policy.largest_gap_mm
            and self.contacts.at_rest()
            and self.contacts.coulomb_excess() <= largest_excess
        )

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
        largest_n = self.policy.largest_residual * force_n + 2 * self._contact_newton.rounding_n
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
        self.snapped |= bool(away_share > self.policy.snapped_load_share)
        return bool(away_share > self.policy.runaway_load_share)

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
        policy = self.policy
        record = self._record(converged)
        acceleration = AndersonAcceleration(policy)
        for _ in range(policy.polishing_iterations):
            diagnostics = record.diagnostics
            obeys_coulomb = diagnostics.coulomb_excess <= policy.largest_coulomb_excess
            if not converged or (obeys_coulomb and diagnostics.tension < policy.largest_error):
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
        diagnostics = SolveDiagnostics(iterations=self.iterations)
        if finite:
            friction = self.contacts.vertex_friction()
            origin_mm = indenter_mm + np.array([0.0, 0.0, self.body.origin_height_mm])
            diagnostics = replace(
                audit_contact(mesh, vertices_mm, problem.mesh_moduli, friction, self.body, origin_mm),
                iterations=self.iterations,
                sticking_fraction=self.contacts.sticking_fraction(),
                slip_mm=float(self.slip_mm.max()),
            )
        sound = (
            max(diagnostics.residual, diagnostics.imbalance, diagnostics.tension) < self.policy.largest_error
            and diagnostics.coulomb_excess <= self.policy.largest_coulomb_excess
            and diagnostics.min_volume_ratio > 0
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
            diagnostics=diagnostics,
        )


class Linearisation:
    """Which tangent an iteration takes: that of its own state, or that of an earlier one, for an eighth of the time.

    An earlier one serves while increments shrink fast, and while a new one would not shrink them faster. If every
    tangent is new, a ball's press and drags at `draft` take 1.2 to 1.3 times as long, a box's press 1.05 times: twice
    as many factorisations, half as many iterations. A ball's force is 0.05 % off with kept tangents, 0.01 without.
    """

    def __init__(self, policy: Policy = POLICY) -> None:
        self._policy = policy
        self._increment_mm = np.inf
        self._patience = 0
        # How many slow increments may still keep the tangent.
        self._spare = 0
        self.keeps = False

    def is_too_long(self, increment_mm: float) -> bool:
        """Return whether an increment by a kept tangent leads astray; one that is not a number does."""
        policy = self._policy
        ratio = policy.largest_patient_ratio if self._spare else policy.largest_kept_ratio
        return not increment_mm <= ratio * self._increment_mm

    def follow(self, increment_mm: float, *, is_new: bool) -> None:
        """Take note of an increment by a tangent that `is_new` or kept, and decide whether the next one keeps it."""
        policy = self._policy
        fast = increment_mm <= policy.kept_tangent_ratio * self._increment_mm
        self._increment_mm = increment_mm
        if is_new:
            self._patience = 0 if fast else min(max(2, 2 * self._patience), policy.most_patience)
            self._spare = self._patience
        elif not fast:
            self._spare = max(0, self._spare - 1)
        self.keeps = fast or self._spare > 0


class StepControl:
    """How long a load step may be, and take: short at first contact, in halves where it fails or vertices run away.

    Without it a box's press at `draft` is 0.7 % off, with it 0.02 %; a ball's is as exact without, 0.05 %. It takes a
    tenth to a half more time: short first steps, and a load step in which vertices run away is taken twice.
    """

    def __init__(self, problem: ContactProblem, policy: Policy = POLICY) -> None:
        self._problem, self._policy = problem, policy

    def at_first_contact(self, shares: Floats) -> Floats:
        """Return the shares (n,) of a way onto the gel at which load steps end, with those within the first one."""
        return np.concatenate([np.array(self._policy.first_contact_shares) / len(shares), shares])

    def most_iterations(self, halvings: int, left: int) -> int:
        """Return how many iterations a load step that was halved so often may take, of those `left`."""
        smallest = halvings == self._policy.most_halvings
        return min(self._policy.iterations_per_step * (2 if smallest else 1), left)

    def tolerance(self, step: Floats, *, kept_tangent: bool) -> float:
        """Return by what share of the force the last iteration of a load step (6,) may change it."""
        quality = self._problem.quality
        is_travel = step[:2].any() or step[3:].any()
        tolerance = quality.travel_tolerance if is_travel else quality.press_tolerance
        return self._policy.kept_tangent_tolerance * tolerance if kept_tangent else tolerance

    def furthest_slip_mm(self, step: Floats) -> float:
        """Return how far a vertex may slide in a load step (6,); one that slides further runs away."""
        moved_mm = float(np.linalg.norm(step[:3]))
        if step[3:].any():
            moved_mm += self._problem.arc_mm(step[3:])
        squeezed_mm = self._policy.squeezed_ratio * self._problem.contact_width * abs(float(step[2]))
        return max(self._policy.runaway_ratio * moved_mm, squeezed_mm)


class AndersonAcceleration:
    """Anderson's acceleration of an iteration x → x + f(x): the next x is where f is least by its last values.

    (Walker & Ni 2011, SIAM J. Numer. Anal. 49:1715). Friction alone settles by some 0.85 an iteration. Under
    high friction a vertex at the rim lets go by increments that each grow by 4 %: leaps lead it on.
    Without both a drag without slip at `draft` takes 120 iterations, with them 66, in 0.8 of the time; presses and a
    drag near full slip gain nothing, and none of these four scenes has a leap.
    """

    def __init__(self, policy: Policy = POLICY) -> None:
        self._policy = policy
        self._places: list[Floats] = []
        self._increments: list[Floats] = []
        self._drifted = 0

    def correction(self, place: Floats, increment: Floats, furthest: float) -> Floats:
        """Add an increment f (n,) and where it has led (n,); return what to add to that, up to `furthest` each.

        A longer increment than the last one shows that the iteration has changed, or leads away from where it was: one
        that does so again and again, and straight on, is led further at once.
        """
        policy = self._policy
        if self._increments:
            last, size = self._increments[-1], np.linalg.norm(increment)
            grows = size > np.linalg.norm(last)
            is_along = increment @ last > policy.along * size * np.linalg.norm(last)
            self._drifted = self._drifted + 1 if grows and is_along else 0
            if grows:
                self._places, self._increments = [], []
        self._places = [*self._places, np.array(place)][-policy.remembered :]
        self._increments = [*self._increments, np.array(increment)][-policy.remembered :]
        if self._drifted >= policy.drifted:
            return increment * policy.leap_share * furthest / max(float(np.abs(increment).max()), 1e-300)
        # One change alone may be the gel's, which is not linear.
        if len(self._increments) < 3:
            return np.zeros_like(increment)
        changes = np.diff(np.column_stack(self._increments))
        shares, *_ = np.linalg.lstsq(changes, increment, rcond=policy.smallest_singular_value)
        correction = -np.diff(np.column_stack(self._places)) @ shares
        return correction * min(1.0, furthest / max(float(np.abs(correction).max()), 1e-300))
