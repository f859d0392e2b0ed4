"""The solution of one iteration's contact problem, on the vertices in contact alone: where MuJoCo's solver starts."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, sparse
from threadpoolctl import threadpool_limits

from gelgap.sim.mujoco_model import GelModel
from gelgap.sim.multifrontal import Condensation

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

# Newton's method stops once no more than this share of all forces is unbalanced, which is as good as rounding errors
# let it be, or after this many steps.
_SMALLEST_GRADIENT = 1e-12
_MOST_STEPS = 60
# A step is taken whole if the slope at its end is at most this share of the one at its beginning.
_SMALL_SLOPE = 0.1
_LONGEST_STEP = 1024.0


def one_thread() -> threadpool_limits:
    """While entered, linear algebra takes one thread: several wait for one another at hundreds of small matrices."""
    return threadpool_limits(limits=1, user_api="blas")


class ContactNewton:
    """Minimises what MuJoCo's solver minimises: ½ aᵀ A a − bᵀ a + the cost of contacts at the residual J a − a_ref.

    A is mass and stiffness, b the force without contacts; they, J, a_ref and the cost are MuJoCo's own, in the present
    state of its data (https://mujoco.readthedocs.io/en/stable/computation, "Constraint solver"). The problem is convex
    and has one solution. Vertices on which no contact acts are eliminated from it first.
    """

    def __init__(self, gel: GelModel, data: Any) -> None:
        model = gel.model
        self._data = data
        self._contacts = _Contacts(model, data)
        self._indenter_dofs = np.arange(model.nv)[gel.indenter_dof]
        self._diagonal_of_mass = model.M_rowadr + model.M_rownnz - 1
        nodes = gel.vertex_of_geom[gel.vertex_of_geom >= 0]
        inner = np.setdiff1d(np.flatnonzero(gel.vertex_dof >= 0), nodes)
        starts = np.append(data.efm_K_rowadr, data.nefmK)
        stiffness = sparse.csr_array((data.efm_K_val, data.efm_K_colind, starts), shape=(model.nv, model.nv))
        # The mesh numbers its vertices in reverse order of elimination.
        order = np.concatenate([inner[::-1], nodes])
        self._condensation = Condensation(stiffness, gel.vertex_dof[order], len(nodes))

    def acceleration(self) -> Floats:
        """Return the acceleration a (nv,) that solves the problem; the data's contact forces become those of it.

        Raises
        ------
        numpy.linalg.LinAlgError
            If A is not positive definite, or not finite.
        """
        data, kept_dofs, indenter_dofs = self._data, self._condensation.kept_dofs, self._indenter_dofs
        diagonal, force = data.M[self._diagonal_of_mass] + data.efm_diag, data.qfrc_smooth + data.efm_c
        contact_dofs = data.efc_J_colind.reshape(-1, 3, 6)[:, 0]
        condensed = self._condensation.condense(data.efm_K_val, diagonal, force)
        kept = _Reduced(*condensed, touched=np.isin(kept_dofs, contact_dofs))
        if not (np.isfinite(kept.stiffness).all() and np.isfinite(kept.force).all()):
            raise np.linalg.LinAlgError("the gel's stiffness or force is not finite")
        moving = np.concatenate([kept_dofs[kept.touched], indenter_dofs])
        number = np.empty(len(force), dtype=np.int64)
        number[moving] = np.arange(len(moving))
        solution = self._contacts.minimum(
            linalg.block_diag(kept.stiffness, np.diag(diagonal[indenter_dofs])),
            np.concatenate([kept.force, force[indenter_dofs]]),
            number[contact_dofs],
        )
        acceleration = self._condensation.expand(kept.expand(solution[: -len(indenter_dofs)]))
        acceleration[indenter_dofs] = solution[-len(indenter_dofs) :]
        return acceleration


class _Reduced:
    """A x = b (n, n), given by A's lower triangle, on the dofs that contacts touch; all others are eliminated."""

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
        x[~self.touched] = linalg.solve_triangular(
            self._factor, left, trans=1, lower=True, check_finite=False
        )
        return x


class _Contacts:
    """The contacts in MuJoCo's data, each with three rows and six dofs: three of its node, three of the indenter."""

    def __init__(self, model: Any, data: Any) -> None:
        import mujoco

        self._mujoco = mujoco
        self._model, self._data = model, data

    def minimum(self, stiffness: Floats, force: Floats, dofs: Ints) -> Floats:
        """Return the minimum (n,) of ½ xᵀ `stiffness` x − `force` · x + the cost of contacts that act on `dofs` (c, 6).

        By Newton's method, with a search for the least cost along each step.
        """
        self._dofs, self._jacobian = dofs, self._data.efc_J.reshape(-1, 3, 6)
        solution, residual = np.zeros(len(force)), -np.array(self._data.efc_aref)
        given = np.linalg.norm(force)
        for _ in range(_MOST_STEPS):
            contact_force = self._force(residual, stiffness=True)
            gradient = stiffness @ solution - force
            np.add.at(gradient, dofs, -np.einsum("cij,ci->cj", self._jacobian, contact_force.reshape(-1, 3)))
            if np.linalg.norm(gradient) <= _SMALLEST_GRADIENT * (np.linalg.norm(contact_force) + given):
                break
            factor = linalg.cho_factor(self._stiffened(stiffness), lower=True, check_finite=False)
            step = -linalg.cho_solve(factor, gradient, check_finite=False)
            along = np.einsum("cij,cj->ci", self._jacobian, step[dofs]).ravel()
            slope = gradient @ step + contact_force @ along
            length = self._step_length(slope, step @ stiffness @ step, residual, along)
            solution, residual = solution + length * step, residual + length * along
        return solution

    def _force(self, residual: Floats, *, stiffness: bool = False) -> Floats:
        """Return the contacts' forces (3 c,) at a residual (3 c,); the data gets their `stiffness`, if wanted."""
        self._mujoco.mj_constraintUpdate(self._model, self._data, residual, None, stiffness)
        return np.array(self._data.efc_force)

    def _stiffened(self, matrix: Floats) -> Floats:
        """Return a matrix (n, n) plus the stiffness of the contacts at the last force."""
        data, states = self._data, self._mujoco.mjtConstraintState
        state, total = data.efc_state.reshape(-1, 3)[:, 0], matrix.copy()
        sticks, slides = state == states.mjCNSTRSTATE_QUADRATIC, state == states.mjCNSTRSTATE_CONE
        stiffness = np.zeros((len(state), 3, 3))
        stiffness[sticks] = data.efc_D.reshape(-1, 3)[sticks, :, None] * np.eye(3)
        stiffness[slides] = data.contact.H[slides, :9].reshape(-1, 3, 3)
        blocks = np.einsum("cia,cij,cjb->cab", self._jacobian, stiffness, self._jacobian)
        np.add.at(total, (self._dofs[:, :, None], self._dofs[:, None, :]), blocks)
        return total

    def _step_length(self, slope: float, curvature: float, residual: Floats, along: Floats) -> float:
        """Return where along a step the cost is least, by its `slope` and `curvature` without those of the contacts."""

        def slope_at(length: float) -> float:
            return slope + length * curvature - float(self._force(residual + length * along) @ along)

        longest, slope_there = 1.0, slope_at(1.0)
        if abs(slope_there) <= _SMALL_SLOPE * abs(slope_at(0.0)):
            return longest
        while slope_there < 0 and longest < _LONGEST_STEP:
            longest *= 2
            slope_there = slope_at(longest)
        # A step may end where the first node touches, which can be as near as rounding lets it be.
        return optimize.brentq(slope_at, 0.0, longest, xtol=1e-14) if slope_there > 0 else longest
