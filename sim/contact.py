"""Contact and friction of an iteration: Coulomb's law of a load step, and the contact problem, condensed and solved."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, sparse
from scipy.spatial import Delaunay

from gelgap.sim.fronts import Condensation, Group
from gelgap.sim.indenter import Floats, Indenter, Ints
from gelgap.sim.membrane import shares_mm2
from gelgap.sim.mujoco_model import NODE_RADIUS_MM, GelModel
from gelgap.sim.problem import ContactProblem
from gelgap.sim.relief import recesses_of
from gelgap.sim.solution import sticks

# MuJoCo wants some friction at every contact; nodes that are not held get this.
_FRICTIONLESS = 1e-5
# MuJoCo takes the y axis for a contact's first tangent unless the normal is this near to it.
_NOT_ALONG_Y = 0.5
# Contacts with less than this share of the largest normal force are noise that says nothing about friction.
_NEGLIGIBLE_LOAD_SHARE = 1e-2
# Static friction falls to kinetic over this slip. If it fell at once, slip would run from the rim, where the pressure
# vanishes, through any contact, the sooner the finer the mesh (Papangelo et al. 2015, arXiv:1506.06043).
_WEAKENING_SLIP_MM = 0.05

# Newton's method on the condensed problem has converged once the residual is no more than the first share of all
# forces, or no more than the second beside rounding errors and no longer halved, which is as good as it gets.
_RESIDUAL_TOLERANCE = 1e-12
_ROUNDED_RESIDUAL = 1e-10
# Nodes may come into contact one an iteration.
_MOST_ITERATIONS = 400
# An increment is taken whole if the slope at its end is at most this share of the one at its beginning.
_SMALL_SLOPE = 0.1
_LONGEST_STEP = 1024.0


class FrictionalContacts:
    """The contacts in MuJoCo's data; arrays have an entry per contact, in MuJoCo's order.

    Friction acts against the slip since the load step's start: Coulomb's law of a load step (backward Euler) is about
    this slip and not that of one iteration. A node is active if the last iteration pressed it. Nodes that are active
    when the step begins stick from where they are then. A node that becomes active within the step has landed, on
    average half way: its slip counts from half way between its position at the start of the step and the one that it
    reached without friction. Other nodes slide freely.

    The coefficient falls, with the slip since a node touched, from the static to the kinetic one. Where a body has
    recesses that its mesh bridges, nodes sink into it as the gel fills them.
    """

    def __init__(self, gel: GelModel, data: Any, problem: ContactProblem) -> None:
        self._gel, self._data = gel, data
        self._indenter: Indenter = problem.indenter
        self._friction = float(problem.friction)
        static = problem.static_friction
        self._static_excess = 0.0 if static is None else static - self._friction
        # A contact's frame leads from the indenter to the node, or back: MuJoCo orders its two geoms by their types.
        is_sphere = gel.model.geom_type[gel.indenter_geom] == int(mujoco.mjtGeom.mjGEOM_SPHERE)
        self._sign = 1.0 if is_sphere else -1.0
        # Each geom's coefficient, and how far it had slid before this load step.
        self._friction_of = np.full(gel.model.ngeom, self._friction)
        self._slid_mm = np.zeros(gel.model.ngeom)
        self._start_mm: Floats | None = None
        self._anchor_mm = np.zeros((0, 3))
        self._held = np.zeros(0, dtype=bool)
        self._landed = np.zeros(0, dtype=bool)
        # How the indenter has turned in this load step.
        self._turned = np.eye(3)
        self._recesses = recesses_of(problem)
        if self._recesses is not None:
            rest_mm = gel.mesh.vertices_mm
            triangles = Delaunay(rest_mm[gel.mesh.surface, :2]).simplices
            self._area_mm2 = shares_mm2(rest_mm, gel.mesh.surface[triangles])

    @property
    def nodes(self) -> Ints:
        """Each contact's node; the indenter's geom comes before those of nodes."""
        return self._data.contact.geom.max(axis=1)

    @property
    def forces_n(self) -> Floats:
        """Each contact's force along its normal and two tangents, (contacts, 3)."""
        return self._data.efc_force[: 3 * self._data.ncon].reshape(-1, 3)

    @property
    def normal_force_n(self) -> Floats:
        return self.forces_n[:, 0]

    @property
    def loaded(self) -> NDArray[np.bool_]:
        """Whether each contact carries more than a negligible share of the largest normal force."""
        normal = self.normal_force_n
        return normal > _NEGLIGIBLE_LOAD_SHARE * normal.max(initial=0.0)

    def place(self) -> None:
        """Give each contact that MuJoCo found the gap and normal of the indenter's own surface."""
        data = self._data
        places_mm = self._places_mm()[self.nodes]
        nearest = self._indenter.project(places_mm)
        normal = nearest.outward_normal * self._sign
        # The first tangent is as MuJoCo chooses it.
        other = np.where(np.abs(normal[:, 1:2]) < _NOT_ALONG_Y, [[0.0, 1.0, 0.0]], [[0.0, 0.0, 1.0]])
        first = other - (other * normal).sum(axis=1, keepdims=True) * normal
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        data.contact.frame[:] = np.concatenate([normal, first, np.cross(normal, first)], axis=1)
        data.contact.dist[:] = nearest.distance_mm - NODE_RADIUS_MM
        if self._recesses is not None:
            sunk_mm, pressure_mpa, compliance = self._recesses.resistance(
                places_mm, self._indenter, -nearest.distance_mm
            )
            data.contact.dist[:] += sunk_mm
            self._sunk_by_mm = compliance * pressure_mpa
            self._compliance = compliance / self._area_mm2[self._gel.vertex_of_geom[self.nodes]]

    def soften(self) -> None:
        """Give the contacts that MuJoCo has just made the compliance of the gel that fills recesses."""
        if self._recesses is None or not self._data.ncon:
            return
        data, normal = self._data, slice(0, 3 * self._data.ncon, 3)
        stiffer = data.efc_R[normal] / (data.efc_R[normal] + self._compliance)
        data.efc_R[normal] /= stiffer
        data.efc_D[normal] *= stiffer
        # So that friction stays what it was.
        data.contact.mu[:] *= np.sqrt(stiffer)
        # MuJoCo's solver takes a copy of its own.
        data.iefc_R[data.map_efc2iefc], data.iefc_D[data.map_efc2iefc] = data.efc_R, data.efc_D

    def begin_load_step(self, slid_mm: Floats) -> None:
        """Begin a new load step, at the next contacts, before which geoms have slid by `slid_mm` (n,)."""
        self._start_mm = None
        self._slid_mm = slid_mm
        self._turned = np.eye(3)

    def turn(self, turn: Floats, indenter: Indenter) -> None:
        """Go on with the indenter turned by a matrix (3, 3) about its origin; what sticks to it goes along."""
        self._indenter = indenter
        if self._start_mm is not None:
            self._start_mm, self._anchor_mm = self._start_mm @ turn.T, self._anchor_mm @ turn.T
            self._turned = turn @ self._turned

    def carried_mm(self, turn: Floats) -> Floats:
        """Return how far a turn (3, 3) of the indenter carries its surface along normal and tangents, (contacts, 3)."""
        place_mm = self._places_mm()[self.nodes]
        frames = self._data.contact.frame.reshape(-1, 3, 3)
        return np.einsum("nij,nj->ni", frames, place_mm @ turn.T - place_mm) * self._sign

    def impose_friction(self, active: NDArray[np.bool_], turn: Floats | None = None) -> None:
        """Write into MuJoCo's contacts what makes its friction act as Coulomb's law of the load step.

        A contact's surface velocity is added to its friction rows; as an iteration takes 1 s, it stands for the slip so
        far. MuJoCo's convex friction cone lets a node that slides by s rise by μ s (Anitescu 2006, Math.
        Program. 105:113). The gap is widened by as much, so that a settled node slides on the indenter (the fixed point
        of De Saxcé & Feng 1998, Math. Comput. Model. 28:225). In this iteration the indenter turns by `turn` (3, 3).
        """
        data, nodes, place_mm = self._data, self.nodes, self._places_mm()
        if self._start_mm is None:
            self._start_mm = place_mm
            self._anchor_mm = place_mm.copy()
            self._held = active.copy()
        self._landed = active & ~self._held
        self._anchor_mm[self._landed] = (self._start_mm + place_mm)[self._landed] / 2
        self._held |= self._landed
        held = self._held[nodes]
        tangents = data.contact.frame.reshape(-1, 3, 3)[:, 1:]
        # Slip in a load step that turns goes along an arc. Its chord counts in the body's axes at the step's start: a
        # ball that twists by 60° while it is dragged has Fy within 3 % of twelve legs' so, and else 32 % off.
        slip_mm = (place_mm - self._anchor_mm)[nodes] @ self._turned
        slip_mm = np.einsum("nij,nj->ni", tangents, slip_mm) * self._sign
        slip_mm[~held] = 0.0
        data.contact.surfacevel[:, :2] = slip_mm
        if turn is not None:
            # As its travel does, the indenter's turn moves the surface on during the iteration.
            carried_mm = self.carried_mm(turn)
            data.contact.dist[:] -= carried_mm[:, 0]
            data.contact.surfacevel[held, :2] -= carried_mm[held, 1:]
        if self._static_excess:
            slid_mm = self._slid_mm[nodes] + np.linalg.norm(slip_mm, axis=1)
            left = np.maximum(0.0, 1 - slid_mm / _WEAKENING_SLIP_MM)
            self._friction_of[nodes] = self._friction + left * self._static_excess
            data.contact.friction[:, :2] = self._friction_of[nodes, None]
        # Most nodes that landed go back and stick; a widened gap would press them into the indenter.
        slides_mm = np.where(self._landed[nodes], 0.0, np.linalg.norm(slip_mm, axis=1))
        data.contact.dist[:] += self._friction_of[nodes] * slides_mm
        if self._recesses is not None:
            data.contact.dist[:] -= self._sunk_by_mm
        data.contact.friction[~held, :2] = _FRICTIONLESS

    def forget_landing(self) -> None:
        """Let the nodes that landed in the last iteration land once more in the next."""
        self._held &= ~self._landed

    def at_rest(self) -> bool:
        """Return whether all nodes with load are held, and none of them landed in the last iteration."""
        return bool((self._held & ~self._landed)[self.nodes[self.loaded]].all())

    def coulomb_excess(self) -> float:
        """Return the largest |f_t| / (μ f_n) − 1 of loaded contacts; −1 without friction.

        Friction was bounded along the normals that the iteration began with; where nodes have gone on, normals have
        turned.
        """
        data, gel, loaded = self._data, self._gel, self.loaded
        if not loaded.any() or self._friction == 0:
            return -1.0
        nodes = self.nodes[loaded]
        first_dof = gel.vertex_dof[gel.vertex_of_geom[nodes]]
        moved = data.qvel[first_dof[:, None] + np.arange(3)] - data.qvel[gel.indenter_dof]
        normal = self._indenter.project(self._places_mm()[nodes] + moved).outward_normal
        frames = data.contact.frame.reshape(-1, 3, 3)
        force = (np.einsum("ni,nij->nj", self.forces_n, frames) * self._sign)[loaded]
        normal_force = np.einsum("ni,ni->n", force, normal)
        tangential_force = np.linalg.norm(force - normal_force[:, None] * normal, axis=1)
        return float((tangential_force / (self._friction_of[nodes] * normal_force)).max()) - 1

    def sticking_fraction(self) -> float:
        """Return the share of the normal force on nodes whose friction is below its limit."""
        normal = self.normal_force_n
        if not normal.sum() > 0:
            return 1.0
        tangential = np.linalg.norm(self.forces_n[:, 1:], axis=1)
        sticking = sticks(tangential, normal, self._friction_of[self.nodes])
        return float(1.0 - normal[~sticking].sum() / normal.sum())

    def vertex_forces_n(self) -> tuple[Floats, Floats]:
        """Return the normal force (n,) on each vertex of the mesh, and the whole contact force (n, 3)."""
        vertices = self._gel.vertex_of_geom[self.nodes]
        whole = np.zeros_like(self._gel.mesh.vertices_mm)
        normal = np.zeros(len(whole))
        normal[vertices] = self.normal_force_n
        frames = self._data.contact.frame.reshape(-1, 3, 3)
        whole[vertices] = np.einsum("ni,nij->nj", self.forces_n, frames) * self._sign
        return normal, whole

    def vertex_friction(self) -> Floats:
        """Return each mesh vertex's coefficient of friction (n,)."""
        friction = np.full(len(self._gel.mesh.vertices_mm), self._friction)
        friction[self._gel.vertex_of_geom[self.nodes]] = self._friction_of[self.nodes]
        return friction

    def _places_mm(self) -> Floats:
        """Return where all geoms lie, from the indenter's origin, (geoms, 3)."""
        return self._data.geom_xpos - self._data.xpos[self._gel.indenter_body]


class ContactNewton:
    """Minimises what MuJoCo's solver minimises: ½ aᵀ A a − bᵀ a + the cost of contacts at J a − a_ref.

    A is mass and stiffness, b the force without contacts; they, J, a_ref and the cost are MuJoCo's own, in the present
    state of its data (https://mujoco.readthedocs.io/en/stable/computation, "Constraint solver"). The problem is convex
    and has one solution. Dofs on which no contact acts are eliminated from it first. A contact has three rows in J and
    six dofs: three of its node, three of the indenter. `rounding_n` is what rounding may leave unbalanced in the last
    solution.
    """

    def __init__(self, gel: GelModel, data: Any, groups: list[Group]) -> None:
        model = gel.model
        self._model, self._data = model, data
        self._indenter_dofs = np.arange(model.nv)[gel.indenter_dof]
        self._diagonal_of_mass = model.M_rowadr + model.M_rownnz - 1
        # Each geom's J x − a_ref of the last solution; 1 where there was none: nothing presses.
        self._relative = np.ones((model.ngeom, 3))
        self.rounding_n = 0.0
        starts = np.append(data.efm_K_rowadr, data.nefmK)
        stiffness = sparse.csr_array((data.efm_K_val, data.efm_K_colind, starts), shape=(model.nv, model.nv))
        # The mesh numbers its vertices in reverse order of elimination.
        first_dof = gel.vertex_dof[gel.vertex_dof >= 0][::-1]
        self._condensation = Condensation(stiffness, first_dof, groups)

    def factorise(self) -> None:
        """Factorise A of the present state; LinAlgError if it is not positive definite."""
        data = self._data
        diagonal = data.M[self._diagonal_of_mass] + data.efm_diag
        self._lower = self._condensation.factorise(data.efm_K_val, diagonal)
        self._indenter_mass = diagonal[self._indenter_dofs]
        self._touched = np.zeros(0, dtype=bool)

    def acceleration(self) -> Floats:
        """Return the acceleration a (nv,) that solves the problem; the data's contact forces become those of it.

        A is the one that was factorised last, all else is the present state's. LinAlgError if A is not positive
        definite, or not finite.
        """
        data = self._data
        kept_dofs, indenter_dofs = self._condensation.kept_dofs, self._indenter_dofs
        force = data.qfrc_smooth + data.efm_c
        contact_dofs = data.efc_J_colind.reshape(-1, 3, 6)[:, 0]
        right_side = self._condensation.condense(force)
        touched = np.isin(kept_dofs, contact_dofs)
        if not np.array_equal(touched, self._touched):
            self._condense_onto(touched)
        factor, coupling = self._factor_of_others, self._coupling
        others = linalg.solve_triangular(factor, right_side[~touched], lower=True, check_finite=False)
        right_side = right_side[touched] - coupling.T @ others
        if not (np.isfinite(self._compliance).all() and np.isfinite(right_side).all()):
            raise np.linalg.LinAlgError("the gel's stiffness or force is not finite")
        moving = np.concatenate([indenter_dofs, kept_dofs[touched]])
        number = np.empty(len(force), dtype=np.int64)
        number[moving] = np.arange(len(moving))
        solution = self._minimum(np.concatenate([force[indenter_dofs], right_side]), number[contact_dofs])
        kept = np.empty(len(kept_dofs))
        split = len(indenter_dofs)
        kept[touched] = solution[split:]
        left = others - coupling @ kept[touched]
        kept[~touched] = linalg.solve_triangular(factor, left, trans=1, lower=True, check_finite=False)
        acceleration = self._condensation.expand(kept)
        acceleration[indenter_dofs] = solution[:split]
        self.rounding_n = self._rounding_n(acceleration, contact_dofs)
        return acceleration

    def _condense_onto(self, touched: NDArray[np.bool_]) -> None:
        """Condense A onto the indenter and those kept dofs that contacts act on, and invert it there."""
        inner, outer = np.flatnonzero(touched), np.flatnonzero(~touched)
        # The lower triangle alone is held.
        coupling = self._lower[np.ix_(outer, inner)] + self._lower[np.ix_(inner, outer)].T
        factor = linalg.cholesky(self._lower[np.ix_(outer, outer)], lower=True, check_finite=False)
        coupling = linalg.solve_triangular(factor, coupling, lower=True, check_finite=False)
        lower = self._lower[np.ix_(inner, inner)]
        condensed = lower + np.tril(lower, -1).T - coupling.T @ coupling
        condensed_factor = linalg.cho_factor(condensed, lower=True, check_finite=False)
        inverse = linalg.cho_solve(condensed_factor, np.eye(len(inner)), check_finite=False)
        self._touched = touched
        self._factor_of_others = factor
        self._coupling = coupling
        self._stiffness = linalg.block_diag(np.diag(self._indenter_mass), condensed)
        self._compliance = linalg.block_diag(np.diag(1 / self._indenter_mass), inverse)

    def _minimum(self, force: Floats, dofs: Ints) -> Floats:
        """Return the minimum (n,) of ½ xᵀ S x − `force` · x + the cost of contacts that act on `dofs` (c, 6).

        S is the condensed stiffness. By Newton's method with a line search; `relative` is J x − a_ref.
        """
        jacobian, stiffness = self._data.efc_J.reshape(-1, 3, 6), self._stiffness
        given = np.linalg.norm(force)
        left = np.inf
        solution, relative = self._start(force, jacobian, dofs)
        for _ in range(_MOST_ITERATIONS):
            contact_force = self._contact_force(relative, stiffness=True)
            residual = stiffness @ solution - force - _on_dofs(jacobian, contact_force, dofs, len(force))
            last, left = left, float(np.linalg.norm(residual))
            forces = np.linalg.norm(contact_force) + given
            if left <= _RESIDUAL_TOLERANCE * forces or (
                left > last / 2 and left <= _ROUNDED_RESIDUAL * forces + self._rounding_n(solution, dofs)
            ):
                break
            increment = self._increment(residual, jacobian, dofs)
            along = np.einsum("cij,cj->ci", jacobian, increment[dofs]).ravel()
            slope = residual @ increment + contact_force @ along
            length = self._line_search(slope, increment @ stiffness @ increment, relative, along)
            solution = solution + length * increment
            relative = relative + length * along
        self._relative[self._data.contact.geom.max(axis=1)] = np.nan_to_num(relative, nan=1.0).reshape(-1, 3)
        return solution

    def _start(self, force: Floats, jacobian: Floats, dofs: Ints) -> tuple[Floats, Floats]:
        """Return x (n,) and J x − a_ref (3 c,) to start at: what the tangent of where the last solution ended leads to.

        From there half as many increments are left as from rest.
        """
        last = self._relative[self._data.contact.geom.max(axis=1)].ravel()
        given = -np.array(self._data.efc_aref)
        contact_force = self._contact_force(last, stiffness=True).reshape(-1, 3)
        pressing, root = self._roots()
        moved = (given - last).reshape(-1, 3)[pressing, :, None]
        contact_force[pressing] -= (root @ (root.transpose(0, 2, 1) @ moved))[:, :, 0]
        residual = -force - _on_dofs(jacobian, contact_force, dofs, len(force))
        solution = self._increment(residual, jacobian, dofs)
        return solution, given + np.einsum("cij,cj->ci", jacobian, solution[dofs]).ravel()

    def _rounding_n(self, solution: Floats, dofs: Ints) -> float:
        """Return what rounding leaves unbalanced at x (n,), where J x and a_ref cancel at contacts that press.

        These are so stiff that of a touch of 0.1 mN that slides by 0.1 mm it is 10⁻¹⁰ of the force and more.
        """
        data = self._data
        moved = np.einsum("cij,cj->ci", np.abs(data.efc_J.reshape(-1, 3, 6)), np.abs(solution)[dofs]).ravel()
        cancelling_n = data.efc_D * (moved + np.abs(data.efc_aref)) * (data.efc_force != 0)
        return float(np.finfo(np.float64).eps * np.linalg.norm(cancelling_n))

    def _contact_force(self, relative: Floats, *, stiffness: bool = False) -> Floats:
        """Return the contacts' forces (3 c,) at J x − a_ref (3 c,); the data gets their `stiffness`, if wanted."""
        mujoco.mj_constraintUpdate(self._model, self._data, relative, None, stiffness)
        return np.array(self._data.efc_force)

    def _increment(self, residual: Floats, jacobian: Floats, dofs: Ints) -> Floats:
        """Return what takes a residual (n,) away, by the tangent at the last force.

        That is S + N Nᵀ, with a column of N for each row of a contact that presses. Their number is what is solved for
        (Woodbury's identity): a third to a half of all dofs, since contacts are near vertices rather than touched ones.
        """
        pressing, root = self._roots()
        compliance = self._compliance
        free = -compliance @ residual
        if not len(pressing):
            return free
        columns = jacobian[pressing].transpose(0, 2, 1) @ root
        dofs = dofs[pressing]
        # A contact's first three dofs are the indenter's.
        node_dofs = dofs[:, 3:].ravel()
        of_node = columns[:, 3:].transpose(0, 2, 1)
        count = len(pressing)
        tangent = of_node @ compliance[np.ix_(node_dofs, node_dofs)].reshape(count, 3, -1)
        tangent = of_node @ tangent.reshape(3 * count, -1).T.reshape(count, 3, -1)
        tangent = tangent.reshape(3 * count, -1)
        of_indenter = columns[:, :3].transpose(0, 2, 1).reshape(-1, 3)
        tangent += of_indenter @ compliance[:3, :3] @ of_indenter.T
        tangent[np.diag_indices_from(tangent)] += 1
        factor = linalg.cho_factor(tangent, lower=True, overwrite_a=True, check_finite=False)
        press = np.einsum("cji,cj->ci", columns, free[dofs]).ravel()
        press = linalg.cho_solve(factor, press, check_finite=False)
        return free - compliance @ _on_dofs(columns.transpose(0, 2, 1), press, dofs, len(free))

    def _roots(self) -> tuple[Ints, Floats]:
        """Return which contacts (p,) press at the last force, and R (p, 3, 3) of each, whose stiffness is R Rᵀ."""
        data = self._data
        states = mujoco.mjtConstraintState
        # An array is compared with a number, which is faster than with MuJoCo's own constant.
        quadratic, cone = int(states.mjCNSTRSTATE_QUADRATIC), int(states.mjCNSTRSTATE_CONE)
        state = data.efc_state.reshape(-1, 3)[:, 0]
        pressing = np.flatnonzero((state == quadratic) | (state == cone))
        root = np.sqrt(data.efc_D.reshape(-1, 3)[pressing])[:, :, None] * np.eye(3)
        slides = state[pressing] == cone
        values, vectors = np.linalg.eigh(data.contact.H[pressing[slides], :9].reshape(-1, 3, 3))
        root[slides] = vectors * np.sqrt(np.maximum(values, 0.0))[:, None]
        return pressing, root

    def _line_search(self, slope: float, curvature: float, relative: Floats, along: Floats) -> float:
        """Return where along an increment the cost is least, by its `slope` and `curvature` without the contacts'."""

        def slope_at(length: float) -> float:
            return slope + length * curvature - float(self._contact_force(relative + length * along) @ along)

        longest, slope_there = 1.0, slope_at(1.0)
        if abs(slope_there) <= _SMALL_SLOPE * abs(slope_at(0.0)):
            return longest
        while slope_there < 0 and longest < _LONGEST_STEP:
            longest *= 2
            slope_there = slope_at(longest)
        # An increment may end where the first node touches, which can be as near as rounding lets it be.
        return optimize.brentq(slope_at, 0.0, longest, xtol=1e-14) if slope_there > 0 else longest


def _on_dofs(rows: Floats, values: Floats, dofs: Ints, count: int) -> Floats:
    """Return what rows (c, 3, 6), each times its value (3 c,), add up to on the `dofs` (c, 6) of all, (count,)."""
    at_dofs = np.einsum("cij,ci->cj", rows, values.reshape(-1, 3))
    return np.bincount(dofs.ravel(), at_dofs.ravel(), count).astype(np.float64, copy=False)
