"""Whether a solved contact is in equilibrium, computed from the strain energy itself and not from MuJoCo's flags.

Forces at the vertices follow from their positions alone. Free vertices should carry none; those on the indenter carry
the contact's, which must push and stay within Coulomb's cone; the backing must carry what the indenter exerts.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.indenter import Floats, Indenter
from gelgap.sim.mesh import GelMesh
from gelgap.sim.scene import Moduli
from gelgap.sim.solution import SolveDiagnostics

# A vertex dragged along the indenter leaves it by the second order of its slip in a load step, which is some µm. So
# vertices up to this far from it count as touching; one among them that carries no force is balanced all the same.
_TOUCHING_GAP_MM = 6e-3
# Vertices with less than this share of the largest push are noise that says nothing about friction.
_NEGLIGIBLE_LOAD_SHARE = 1e-2


@dataclass(frozen=True)
class ElasticState:
    """Energy in mJ, the force (vertices, 3) in N that holds each vertex in place, and each tetrahedron's J."""

    energy_mj: float
    holding_force_n: Floats
    volume_ratio: Floats


def elastic_state(
    vertices_mm: Floats, tetrahedra: NDArray[np.int32], positions_mm: Floats, moduli: Moduli
) -> ElasticState:
    """Evaluate W = μ/2 (I₁ − 3) − μ (J − 1) + (λ + μ)/2 (J − 1)² on linear tetrahedra (MuJoCo's Stable Neo-Hookean).

    Smith, de Goes & Kim 2018, ACM Trans. Graph. 37(2):12, with the rest-stable moduli that MuJoCo uses.
    """
    mu, lame = moduli.shear_mpa, moduli.lame_mpa
    rest, now = (
        points[tetrahedra[:, 1:]] - points[tetrahedra[:, :1]] for points in (vertices_mm, positions_mm)
    )
    inverse = np.linalg.inv(rest)
    volume = np.abs(np.linalg.det(rest)) / 6
    # Rows are edges: now = rest Fᵀ.
    gradient = inverse @ now
    j = np.linalg.det(gradient)
    cofactor = np.stack(
        [np.cross(gradient[:, (i + 1) % 3], gradient[:, (i + 2) % 3]) for i in range(3)], axis=1
    )
    stress = mu * gradient + (-mu + (lame + mu) * (j - 1))[:, None, None] * cofactor
    energy = mu / 2 * ((gradient**2).sum((1, 2)) - 3) - mu * (j - 1) + (lame + mu) / 2 * (j - 1) ** 2
    edge_force = volume[:, None, None] * np.swapaxes(inverse, 1, 2) @ stress
    force = np.concatenate([-edge_force.sum(1, keepdims=True), edge_force], axis=1)
    nodes = tetrahedra.ravel()
    holding = np.stack(
        [np.bincount(nodes, force[..., axis].ravel(), len(vertices_mm)) for axis in range(3)], axis=-1
    ).astype(float)
    return ElasticState(float((volume * energy).sum()), holding, j)


def audit_contact(
    mesh: GelMesh,
    positions_mm: Floats,
    moduli: Moduli,
    friction: float | Floats,
    indenter: Indenter,
    indenter_origin_mm: Floats,
) -> SolveDiagnostics:
    """Check the equilibrium of vertices at `positions_mm` (n, 3); `moduli` are those of MuJoCo's energy.

    `friction` is the coefficient, of all vertices or of each (n,).
    SolveDiagnostics of the iteration (iterations, slip, sticking) are not known here and left out.
    """
    state = elastic_state(mesh.vertices_mm, mesh.tetrahedra, positions_mm, moduli)
    holding = state.holding_force_n.copy()
    holding[mesh.symmetry_plane, 1] = 0.0
    nearest = indenter.project(positions_mm[mesh.surface] - indenter_origin_mm)
    near = nearest.distance_mm < _TOUCHING_GAP_MM
    touching, normal = mesh.surface[near], nearest.outward_normal[near]
    push = (holding[touching] * normal).sum(1)
    drag = np.linalg.norm(holding[touching] - push[:, None] * normal, axis=1)

    free = np.setdiff1d(np.arange(len(positions_mm)), np.concatenate([touching, mesh.bottom]))
    total = holding[touching].sum(0)
    backing = holding[mesh.bottom].sum(0)
    if mesh.symmetric:
        total[1] = backing[1] = 0.0
    size = max(float(np.linalg.norm(total)), 1e-300)
    out_of_balance = float(np.abs(holding[free]).max(initial=0.0))
    strongest = float(push.max(initial=0.0))
    loaded = push > _NEGLIGIBLE_LOAD_SHARE * strongest
    excess = -1.0
    coefficients = np.broadcast_to(friction, len(positions_mm))[touching][loaded]
    if np.any(coefficients > 0):
        # The largest force on a free vertex shows how uncertain the friction is.
        excess = float(((drag[loaded] - out_of_balance) / (coefficients * push[loaded]) - 1).max())
    return SolveDiagnostics(
        residual=out_of_balance / size,
        imbalance=float(np.linalg.norm(total + backing)) / size,
        coulomb_excess=excess,
        tension=max(0.0, -float(push.min(initial=0.0))) / max(strongest, 1e-300),
        elastic_energy_mj=state.energy_mj * (2 if mesh.symmetric else 1),
        min_volume_ratio=float(state.volume_ratio.min()),
    )
