"""One step of Newton's method for the project's own finite elements: a pad's stiffness and its contact's together."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

Floats = NDArray[np.float64]


def solve_tangent(
    stiffness: sparse.csc_matrix,
    contact_dofs: NDArray[np.int64],
    contact_tangent: Floats,
    free: NDArray[np.int64],
    right_side: Floats,
) -> Floats:
    """Solve the tangent system of pad and contact for the change of all dofs; fixed ones stay at zero.

    `contact_dofs` (nodes, d) are the dofs of the surface nodes, `contact_tangent` (nodes, d, d) the negative slope of
    the contact's force on each, `free` (m,) the dofs that are not fixed and `right_side` (m,) the forces on them.
    """
    rows = np.broadcast_to(contact_dofs[:, :, None], contact_tangent.shape).ravel()
    columns = np.broadcast_to(contact_dofs[:, None, :], contact_tangent.shape).ravel()
    contact = sparse.csc_matrix((contact_tangent.ravel(), (rows, columns)), shape=stiffness.shape)
    tangent = (stiffness + contact)[free][:, free].tocsc()
    # Friction makes the tangent unsymmetric, but not its pattern.
    factors = splu(
        tangent, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.01, options={"SymmetricMode": True}
    )
    change = np.zeros(stiffness.shape[0])
    change[free] = factors.solve(right_side)
    return change
