"""A pad of finite elements of finite strain that do not lock: they project the volume ratio on a few functions each.

The mean-dilatation method: Simo, Taylor & Pister 1985, Comput. Methods Appl. Mech. Eng. 51:177. A deformation gradient
F is an array (…, c) of those of its components that can differ from the identity's: row by row nine in three
dimensions, and rr, rz, zr, zz and φφ with symmetry about an axis. The volume ratio J comes with its derivatives `dj`
(…, c) and `ddj` (…, c, c) by the same components. Units are mm, N and MPa.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gelgap.benchmarks.fem.theory import bulk_modulus_mpa, shear_modulus_mpa

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

AXISYMMETRIC = [0, 1, 3, 4, 8]
_i, _j, _k = np.indices((3, 3, 3))
LEVI_CIVITA = (_i - _j) * (_j - _k) * (_k - _i) / 2
# Its product with F is d²J/dF² = ε_ikm ε_jln F_mn.
SECOND_DERIVATIVE = np.einsum("ikm,jln->mnijkl", LEVI_CIVITA, LEVI_CIVITA).reshape(9, 9, 9)


@dataclass(frozen=True)
class NeoHookean:
    """μ/2 (J^(−2/3) I₁ − 3) + K/2 (J − 1)²: the energy of a nearly incompressible silicone, per undeformed volume.

    The volumetric term is left to the elements, which project J − 1.
    """

    young_modulus_mpa: float
    poisson_ratio: float

    @property
    def shear_modulus_mpa(self) -> float:
        return float(shear_modulus_mpa(self.young_modulus_mpa, self.poisson_ratio))

    @property
    def volumetric_modulus_mpa(self) -> float:
        """The factor of (J − 1)²/2."""
        return float(bulk_modulus_mpa(self.young_modulus_mpa, self.poisson_ratio))

    def energy(self, f: Floats, j: Floats) -> Floats:
        """Return the energy density (…), N/mm²."""
        return self.shear_modulus_mpa / 2 * (j ** (-2 / 3) * (f**2).sum(-1) - 3)

    def stress(self, f: Floats, j: Floats, dj: Floats) -> Floats:
        """Return the first Piola–Kirchhoff stress (…, c), MPa."""
        third = (f**2).sum(-1) / (3 * j)
        return self.shear_modulus_mpa * (j ** (-2 / 3))[..., None] * (f - third[..., None] * dj)

    def tangent(self, f: Floats, j: Floats, dj: Floats, ddj: Floats) -> Floats:
        """Return the derivative of the stress by F (…, c, c), MPa."""
        third = (f**2).sum(-1) / (3 * j)
        mixed = f[..., :, None] * dj[..., None, :]
        tangent = (
            np.eye(f.shape[-1])
            - (2 / (3 * j))[..., None, None] * (mixed + np.swapaxes(mixed, -1, -2))
            + (5 * third / (3 * j))[..., None, None] * dj[..., :, None] * dj[..., None, :]
            - third[..., None, None] * ddj
        )
        return self.shear_modulus_mpa * (j ** (-2 / 3))[..., None, None] * tangent


class StableNeoHookean(NeoHookean):
    """μ/2 (I₁ − 3) − μ (J − 1) + (λ + μ)/2 (J − 1)²: MuJoCo's (Smith et al. 2018, ACM Trans. Graph. 37:12)."""

    @property
    def volumetric_modulus_mpa(self) -> float:
        return super().volumetric_modulus_mpa + self.shear_modulus_mpa / 3

    def energy(self, f: Floats, j: Floats) -> Floats:
        return self.shear_modulus_mpa * (((f**2).sum(-1) - 3) / 2 - (j - 1))

    def stress(self, f: Floats, j: Floats, dj: Floats) -> Floats:
        return self.shear_modulus_mpa * (f - dj)

    def tangent(self, f: Floats, j: Floats, dj: Floats, ddj: Floats) -> Floats:
        return self.shear_modulus_mpa * (np.eye(f.shape[-1]) - ddj)


@dataclass(frozen=True)
class Element:
    """At the Gauss points (q): functions of the nodes (q, a), slopes (q, a, d), weights (q,), modes of J − 1 (q, m)."""

    shape: Floats
    slope: Floats
    weights: Floats
    modes: Floats


class Pad:
    """A discretised pad: its strain energy, and forces and stiffness for displacements `u` (dofs,).

    Its `nodes` (n, d) have d displacements each: (x, y, z), or (r, z) with symmetry about an axis. `connectivity`
    (e, a) names the nodes of the elements. `surface` and `surface_area_mm2` are the nodes that can be touched, and the
    area that belongs to each. `pointwise_mpa` of the volumetric modulus acts on J, the rest on its projection.
    """

    def __init__(
        self,
        nodes: Floats,
        connectivity: Ints,
        element: Element,
        material: NeoHookean,
        fixed_dofs: Ints,
        surface: Ints,
        surface_area_mm2: Floats,
        pointwise_mpa: float = 0.0,
    ) -> None:
        self.nodes, self.material, self.pointwise_mpa = nodes, material, pointwise_mpa
        self.projected_mpa = material.volumetric_modulus_mpa - pointwise_mpa
        self.surface, self.surface_area_mm2 = surface, surface_area_mm2
        self.dimensions, self.size = nodes.shape[1], nodes.size
        self.free = np.setdiff1d(np.arange(self.size), fixed_dofs)
        self.dofs = self.dofs_of(connectivity).reshape(len(connectivity), -1)
        self.surface_dofs = self.dofs_of(surface)
        corners, d = nodes[connectivity], self.dimensions
        jacobian = np.einsum("qai,eaj->eqij", element.slope, corners)
        gradient = np.einsum("eqji,qai->eqja", np.linalg.inv(jacobian), element.slope)
        self.volume = np.linalg.det(jacobian) * element.weights
        # An element's displacements times `strain` (e, q, c, dofs of an element) are the components of F − 1.
        strain = np.zeros((*self.volume.shape, d, d, connectivity.shape[1], d))
        for i in range(d):
            strain[:, :, i, :, :, i] = gradient
        self.strain = strain.reshape(*self.volume.shape, d * d, -1)
        components = list(range(9))
        if d == 2:
            components, r = AXISYMMETRIC, corners[..., 0] @ element.shape.T
            self.volume = 2 * np.pi * r * self.volume
            hoop = np.stack([element.shape / r[..., None], np.zeros_like(gradient[:, :, 0])], axis=-1)
            self.strain = np.concatenate([self.strain, hoop.reshape(*r.shape, 1, -1)], axis=2)
        self.identity = np.eye(3).ravel()[components]
        self._second = SECOND_DERIVATIVE[np.ix_(components, components, components)]
        moments = np.einsum("eq,qa,qb->eab", self.volume, element.modes, element.modes)
        # `projection` (e, q, q) turns values at Gauss points into those of the best combination of modes there.
        weighted = element.modes.T * self.volume[:, None, :]
        self.projection = element.modes @ np.linalg.inv(moments) @ weighted

    def dofs_of(self, nodes: Ints) -> Ints:
        """Return the indices (…, d) of the nodes' displacements in `u`."""
        return self.dimensions * nodes[..., None] + np.arange(self.dimensions)

    def deformation(self, u: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        """Return F (e, q, c), J (e, q), and J's first and second derivative by F: J is homogeneous of degree three."""
        f = np.einsum("eqij,ej->eqi", self.strain, u[self.dofs]) + self.identity
        ddj = np.tensordot(f, self._second, 1)
        dj = np.einsum("eqij,eqj->eqi", ddj, f) / 2
        return f, np.einsum("eqi,eqi->eq", dj, f) / 3, dj, ddj

    def energy_mj(self, u: Floats) -> float:
        """Return the stored elastic energy, N mm."""
        f, j, _, _ = self.deformation(u)
        volumetric = self.pointwise_mpa * (j - 1) ** 2 + self.projected_mpa * self._projected(j - 1) ** 2
        return float((self.volume * (self.material.energy(f, j) + volumetric / 2)).sum())

    def assemble(self, u: Floats) -> tuple[Floats, sparse.csc_matrix]:
        """Return internal forces (dofs,) and the tangent stiffness (dofs, dofs).

        Raises
        ------
        FloatingPointError
            If an element is turned inside out.
        """
        f, j, dj, ddj = self.deformation(u)
        if not j.min() > 0:
            raise FloatingPointError("an element has no volume left")
        pressure = (self.pointwise_mpa * (j - 1) + self.projected_mpa * self._projected(j - 1))[..., None]
        stress = self.material.stress(f, j, dj) + pressure * dj
        tangent = self.material.tangent(f, j, dj, ddj) + pressure[..., None] * ddj
        if self.pointwise_mpa:
            tangent += self.pointwise_mpa * dj[..., :, None] * dj[..., None, :]

        elements, points, components, dofs = self.strain.shape
        force = np.einsum("eqij,eqi->ej", self.strain, self.volume[..., None] * stress)
        b = self.strain.reshape(elements, points * components, dofs)
        ab = (self.volume[..., None, None] * (tangent @ self.strain)).reshape(b.shape)
        dilation = np.einsum("eqi,eqij->eqj", dj, self.strain)
        weighted_dilation = self.volume[..., None] * dilation
        stiffness = b.transpose(0, 2, 1) @ ab
        stiffness += self.projected_mpa * weighted_dilation.transpose(0, 2, 1) @ (self.projection @ dilation)
        return np.bincount(self.dofs.ravel(), force.ravel(), self.size), self.matrix(self.dofs, stiffness)

    def matrix(self, dofs: Ints, blocks: Floats) -> sparse.csc_matrix:
        """Return the sparse (dofs, dofs) sum of dense blocks (k, m, m) at their dofs (k, m)."""
        rows = np.broadcast_to(dofs[:, :, None], blocks.shape).ravel()
        columns = np.broadcast_to(dofs[:, None, :], blocks.shape).ravel()
        return sparse.csc_matrix((blocks.ravel(), (rows, columns)), shape=(self.size, self.size))

    def _projected(self, values: Floats) -> Floats:
        return np.einsum("eqp,ep->eq", self.projection, values)
