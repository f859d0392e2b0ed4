"""The solution of one iteration's contact problem, on the vertices in contact alone: where MuJoCo's solver starts."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, sparse

from gelgap.sim.mujoco_model import GelModel
from gelgap.sim.multifrontal import Condensation

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Newton's method ends at this share of the contact forces, which rounding allows, or gives up after so many steps.
_SMALLEST_GRADIENT = 1e-12
_MOST_STEPS = 60
# A step is taken whole if the slope at its end is at most this share of the one at its beginning.
_SMALL_SLOPE = 0.1
_LONGEST_STEP = 1024.0


class ContactNewton:
    """Minimises what MuJoCo's solver minimises: ½ aᵀ A a − bᵀ a + the cost of contacts at J a − a_ref.

    A is mass and stiffness, b the force without contacts; all of it, with the law of contact, is MuJoCo's own, of its
    data's present state (https://mujoco.readthedocs.io/en/stable/computation, "Constraint solver"). It is convex, so
    that there is one solution. Vertices on which no contact acts are eliminated from it first.
    """

    def __init__(self, gel: GelModel, data: Any) -> None:
        self._data = data
        self._law = _ContactLaw(gel.model, data)
        self._indenter_dofs = np.arange(gel.model.nv)[gel.indenter_dof]
        nodes = gel.vertex_of_geom[gel.vertex_of_geom >= 0]
        inner = np.setdiff1d(np.flatnonzero(gel.vertex_dof >= 0), nodes)
        starts = np.append(data.efm_K_rowadr, data.nefmK)
        stiffness = sparse.csr_array((data.efm_K_val, data.efm_K_colind, starts), shape=(gel.model.nv, gel.model.nv))
        # The mesh numbers its vertices in reverse order of elimination.
        order = np.concatenate([inner[::-1], nodes])
        self._condensation = Condensation(stiffness, gel.vertex_dof[order], len(nodes))

    def acceleration(self) -> Floats:
        """Return the acceleration (nv,) that solves the problem.

        Raises
        ------
        numpy.linalg.LinAlgError
            If A is not positive definite.
        """
        data, kept_dofs, indenter_dofs = self._data, self._condensation.kept_dofs, self._indenter_dofs
        diagonal, force = data.M + data.efm_diag, data.qfrc_smooth + data.efm_c
        contact_dofs = data.efc_J_colind.reshape(-1, 3, 6)[:, 0]
        kept = _Reduced(
            *self._condensation.condense(data.efm_K_val, diagonal, force), np.isin(kept_dofs, contact_dofs)
        )
        moving = np.concatenate([kept_dofs[kept.touched], indenter_dofs])
        number = np.empty(len(force), dtype=np.int64)
        number[moving] = np.arange(len(moving))
        self._law.take(number[contact_dofs])
        stiffness = linalg.block_diag(kept.stiffness, np.diag(diagonal[indenter_dofs]))
        solution = _minimum(stiffness, np.concatenate([kept.force, force[indenter_dofs]]), self._law)
        acceleration = self._condensation.expand(kept.expand(solution[:-3]))
        acceleration[indenter_dofs] = solution[-3:]
        return acceleration


class _Reduced:
    """A x = b (n, n), by A's lower triangle, on the dofs that contacts touch (n,), all others eliminated."""

    def __init__(self, stiffness: Floats, force: Floats, touched: NDArray[np.bool_]) -> None:
        self.touched = touched
        whole = np.tril(stiffness) + np.tril(stiffness, -1).T
        self._factor = linalg.cholesky(whole[~touched][:, ~touched], lower=True, check_finite=False)
        both = np.column_stack([whole[~touched][:, touched], force[~touched]])
        both = linalg.solve_triangular(self._factor, both, lower=True, check_finite=False)
        self._coupling, self._others = both[:, :-1], both[:, -1]
        self.stiffness = whole[touched][:, touched] - self._coupling.T @ self._coupling
        self.force = force[touched] - self._coupling.T @ self._others

    def expand(self, solution: Floats) -> Floats:
        """Return x (n,) from its touched dofs."""
        x = np.empty(len(self.touched))
        x[self.touched] = solution
        left = self._others - self._coupling @ solution
        x[~self.touched] = linalg.solve_triangular(self._factor, left, trans=1, lower=True, check_finite=False)
        return x


class _ContactLaw:
    """MuJoCo's law of the contacts in its data, whose six dofs each are numbered anew in every problem."""

    def __init__(self, model: Any, data: Any) -> None:
        import mujoco

        self._mujoco = mujoco
        self._model, self._data = model, data

    def take(self, dofs: Ints) -> None:
        """Turn to a problem in which the data's contacts act on these `dofs` (contacts, 6)."""
        self._dofs = dofs
        self._jacobian = self._data.efc_J.reshape(-1, 3, 6)

    def along(self, motion: Floats) -> Floats:
        """Return how contacts move, (3 contacts,): along their normals and two tangents."""
        return np.einsum("cij,cj->ci", self._jacobian, motion[self._dofs]).ravel()

    def force(self, slip: Floats, *, stiffness: bool = False) -> Floats:
        """Return the contacts' forces (3 contacts,) at J a − a_ref = `slip`, and set their `stiffness` if asked."""
        self._mujoco.mj_constraintUpdate(self._model, self._data, slip, None, stiffness)
        return np.array(self._data.efc_force)

    def added(self, vector: Floats, force: Floats) -> Floats:
        """Return a `vector` (n,) plus the contacts' forces on its dofs."""
        total = vector.copy()
        np.add.at(total, self._dofs, np.einsum("cij,ci->cj", self._jacobian, force.reshape(-1, 3)))
        return total

    def stiffened(self, matrix: Floats) -> Floats:
        """Return a `matrix` (n, n) plus the stiffness of the contacts at the last forces."""
        state, total = self._data.efc_state.reshape(-1, 3)[:, 0], matrix.copy()
        sticking, sliding = (
            state == int(kind)
            for kind in (
                self._mujoco.mjtConstraintState.mjCNSTRSTATE_QUADRATIC,
                self._mujoco.mjtConstraintState.mjCNSTRSTATE_CONE,
            )
        )
        stiffness = np.zeros((len(state), 3, 3))
        stiffness[sticking] = self._data.efc_D.reshape(-1, 3)[sticking, :, None] * np.eye(3)
        stiffness[sliding] = self._data.contact.H[sliding, :9].reshape(-1, 3, 3)
        blocks = np.einsum("cia,cij,cjb->cab", self._jacobian, stiffness, self._jacobian)
        np.add.at(total, (self._dofs[:, :, None], self._dofs[:, None, :]), blocks)
        return total

    @property
    def reference(self) -> Floats:
        return np.array(self._data.efc_aref)


def _minimum(stiffness: Floats, force: Floats, law: _ContactLaw) -> Floats:
    """Return the minimum (n,) by Newton's method with an exact search along each step."""
    solution, slip = np.zeros(len(force)), -law.reference
    for _ in range(_MOST_STEPS):
        contact_force = law.force(slip, stiffness=True)
        gradient = law.added(stiffness @ solution - force, -contact_force)
        if np.linalg.norm(gradient) <= _SMALLEST_GRADIENT * np.linalg.norm(contact_force):
            break
        step = -linalg.solve(law.stiffened(stiffness), gradient, assume_a="pos", check_finite=False)
        slip_step = law.along(step)
        length = _step_length(gradient @ step, step @ stiffness @ step, slip, slip_step, law)
        solution, slip = solution + length * step, slip + length * slip_step
    return solution


def _step_length(slope: float, curvature: float, slip: Floats, slip_step: Floats, law: _ContactLaw) -> float:
    """Return where along a step the cost is least; it begins with a `slope` and has a `curvature` without contacts."""
    without_contacts = slope + law.force(slip) @ slip_step

    def slope_at(length: float) -> float:
        return without_contacts + length * curvature - law.force(slip + length * slip_step) @ slip_step

    longest = 1.0
    if abs(slope_at(longest)) <= _SMALL_SLOPE * abs(slope):
        return longest
    while slope_at(longest) < 0 and longest < _LONGEST_STEP:
        longest *= 2
    return optimize.brentq(slope_at, 0.0, longest, xtol=1e-14, rtol=1e-6) if slope_at(longest) > 0 else longest
