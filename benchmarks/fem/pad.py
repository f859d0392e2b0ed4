"""A pad of finite elements whose volume ratio is projected on a few functions per element, so that they do not lock.

The mean-dilatation method: Simo, Taylor & Pister 1985, Comput. Methods Appl. Mech. Eng. 51:177.
"""

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from gelgap.benchmarks.fem.material import NeoHookean

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Pad(ABC):
    """A discretised pad of one material: its strain energy, and forces and stiffness for displacements `u` (dofs,).

    Its `nodes` (n, d) have d displacements each. A subclass says what the elements (e) are at their Gauss points (q):
    `connectivity` (e, nodes of an element), `strain` (e, q, c, dofs of an element), which turns an element's
    displacements into components of F − 1, `volume` (e, q), and the functions of the projection, `modes` (q, m).
    `surface` and `surface_area_mm2` are the nodes that can be touched, and the area that belongs to each.
    `pointwise_mpa` of the volumetric modulus acts on J itself and the rest on its projection.
    """

    identity: Floats  # the components of F where nothing is deformed
    nodes: Floats
    connectivity: Ints
    surface: Ints
    surface_area_mm2: Floats
    strain: Floats
    volume: Floats
    modes: Floats

    def __init__(self, material: NeoHookean, fixed_dofs: Ints, pointwise_mpa: float = 0.0) -> None:
        self.material = material
        self.pointwise_mpa = pointwise_mpa
        self.projected_mpa = material.volumetric_modulus_mpa - pointwise_mpa
        self.dimensions = self.nodes.shape[1]
        self.size = self.nodes.size
        self.free = np.setdiff1d(np.arange(self.size), fixed_dofs)
        self.dofs = self.dofs_of(self.connectivity).reshape(len(self.connectivity), -1)
        self.surface_dofs = self.dofs_of(self.surface)
        moments = np.einsum("eq,qa,qb->eab", self.volume, self.modes, self.modes)
        # `projection` (e, q, q) turns values at Gauss points into those of the best combination of modes there.
        self.projection = self.modes @ np.linalg.inv(moments) @ (self.modes.T * self.volume[:, None, :])

    @staticmethod
    @abstractmethod
    def volume_ratio(f: Floats) -> Floats:
        """Return J (…) of F (…, c)."""

    @staticmethod
    @abstractmethod
    def volume_ratio_derivatives(f: Floats) -> tuple[Floats, Floats]:
        """Return the first (…, c) and second (…, c, c) derivatives of J by F."""

    def dofs_of(self, nodes: Ints) -> Ints:
        """Return the indices (…, d) of the nodes' displacements in `u`."""
        return self.dimensions * nodes[..., None] + np.arange(self.dimensions)

    def deformation(self, u: Floats) -> tuple[Floats, Floats]:
        """Return F (e, q, c) and J (e, q)."""
        f = np.einsum("eqij,ej->eqi", self.strain, u[self.dofs]) + self.identity
        return f, self.volume_ratio(f)

    def energy_mj(self, u: Floats) -> float:
        """Return the stored elastic energy, N mm."""
        f, j = self.deformation(u)
        volumetric = self.pointwise_mpa * (j - 1) ** 2 + self.projected_mpa * self._projected(j - 1) ** 2
        return float((self.volume * (self.material.energy(f, j) + volumetric / 2)).sum())

    def assemble(self, u: Floats) -> tuple[Floats, sparse.csc_matrix]:
        """Return internal forces (dofs,) and the tangent stiffness (dofs, dofs).

        Raises
        ------
        FloatingPointError
            If an element is turned inside out.
        """
        f, j = self.deformation(u)
        if not j.min() > 0:
            raise FloatingPointError("an element has no volume left")
        dj, ddj = self.volume_ratio_derivatives(f)
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
