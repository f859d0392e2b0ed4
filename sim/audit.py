"""Whether a solved contact is in equilibrium, computed from the strain energy itself and not from MuJoCo's flags.

Forces at the vertices follow from their positions alone. Free vertices should carry none; those on the sphere carry
the contact's, which must push and stay within Coulomb's cone; the backing must carry what the sphere exerts.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.sim.mesh import GelMesh

Floats = NDArray[np.float64]

# A vertex dragged along the sphere leaves it by the second order of its slip in a load step, some µm; a vertex this
# near that carries no force is balanced all the same.
_TOUCHING_MM = 6e-3
# Of the largest nodal contact force: less than this is noise that says nothing about friction or tension.
_NEGLIGIBLE = 1e-2


@dataclass(frozen=True)
class ElasticState:
    """Energy in mJ, the force (vertices, 3) in N that holds each vertex in place, and each tetrahedron's J."""

    energy_mj: float
    holding_force_n: Floats
    volume_ratio: Floats


@dataclass(frozen=True)
class Audit:
    """One equilibrium, checked.

    `residual` is the largest force on a free vertex over the sphere's force; `imbalance` the difference of the forces
    on sphere and backing over the same; `coulomb_excess` the largest of |f_t| / (μ f_n) − 1 over touching vertices
    (−1 without friction to bound), where |f_t| is less what the largest force on a free vertex shows to be uncertain;
    `tension` the largest pull on one over the largest push. `force_n` is the sphere's force on the gel (whole gel).
    """

    force_n: Floats
    residual: float
    imbalance: float
    coulomb_excess: float
    tension: float
    elastic_energy_mj: float
    min_volume_ratio: float


def elastic_state(
    vertices_mm: Floats,
    tetrahedra: NDArray[np.int32],
    positions_mm: Floats,
    young_modulus_mpa: float,
    poisson_ratio: float,
) -> ElasticState:
    """Evaluate W = μ/2 (I₁ − 3) − μ (J − 1) + (λ + μ)/2 (J − 1)² on linear tetrahedra (MuJoCo's Stable Neo-Hookean).

    Smith, de Goes & Kim 2018, ACM Trans. Graph. 37(2):12, with the rest-stable moduli that MuJoCo uses.
    """
    mu = young_modulus_mpa / (2 * (1 + poisson_ratio))
    lame = young_modulus_mpa * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    rest, now = (
        points[tetrahedra[:, 1:]] - points[tetrahedra[:, :1]] for points in (vertices_mm, positions_mm)
    )
    inverse = np.linalg.inv(rest)
    volume = np.abs(np.linalg.det(rest)) / 6
    # rows are edges: now = rest Fᵀ
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
    )
    return ElasticState(float((volume * energy).sum()), holding, j)


def audit_contact(
    mesh: GelMesh,
    positions_mm: Floats,
    *,
    young_modulus_mpa: float,
    poisson_ratio: float,
    friction: float,
    centre_mm: Floats,
    radius_mm: float,
) -> Audit:
    """Check one equilibrium; moduli are MuJoCo's, `centre_mm` and `radius_mm` those of the sphere that nodes touch."""
    state = elastic_state(mesh.vertices_mm, mesh.tetrahedra, positions_mm, young_modulus_mpa, poisson_ratio)
    holding = state.holding_force_n.copy()
    holding[mesh.symmetry_plane, 1] = 0.0
    sides = 2.0 if mesh.half else 1.0
    surface = mesh.surface
    outward = positions_mm[surface] - centre_mm
    distance = np.linalg.norm(outward, axis=1)
    touching = surface[distance < radius_mm + _TOUCHING_MM]
    normal = (outward / distance[:, None])[distance < radius_mm + _TOUCHING_MM]
    push = (holding[touching] * normal).sum(1)
    drag = np.linalg.norm(holding[touching] - push[:, None] * normal, axis=1)

    free = np.setdiff1d(np.arange(len(positions_mm)), np.concatenate([touching, mesh.bottom]))
    total = holding[touching].sum(0)
    backing = holding[mesh.bottom].sum(0)
    if mesh.half:
        total[1] = backing[1] = 0.0
    size = max(float(np.linalg.norm(total)), 1e-300)
    out_of_balance = float(np.abs(holding[free]).max(initial=0.0))
    strongest = float(push.max(initial=0.0))
    loaded = push > _NEGLIGIBLE * strongest
    excess = (
        (drag[loaded] - out_of_balance) / (friction * push[loaded]) - 1
        if friction > 0 and loaded.any()
        else np.array([-1.0])
    )
    return Audit(
        force_n=sides * total,
        residual=out_of_balance / size,
        imbalance=float(np.linalg.norm(total + backing)) / size,
        coulomb_excess=float(excess.max()),
        tension=max(0.0, -float(push.min(initial=0.0))) / max(strongest, 1e-300),
        elastic_energy_mj=sides * state.energy_mj,
        min_volume_ratio=float(state.volume_ratio.min()),
    )
