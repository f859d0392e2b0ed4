"""The neo-Hookean materials of the checking solvers: strain energy, stress and tangent per undeformed volume.

A deformation gradient F is an array (…, c) of those of its components that can differ from the identity's: 9 in three
dimensions, 5 with symmetry about an axis. The volume ratio J comes with its derivatives `dj` (…, c) and `ddj`
(…, c, c) by the same components. The volumetric term κ/2 (J − 1)² is left to the elements, which project J − 1.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelgap.benchmarks.fem.theory import bulk_modulus_mpa, shear_modulus_mpa

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class NeoHookean:
    """What both materials share: their moduli, and κ = K unless the material says otherwise."""

    young_modulus_mpa: float
    poisson_ratio: float

    @property
    def shear_modulus_mpa(self) -> float:
        return float(shear_modulus_mpa(self.young_modulus_mpa, self.poisson_ratio))

    @property
    def volumetric_modulus_mpa(self) -> float:
        return float(bulk_modulus_mpa(self.young_modulus_mpa, self.poisson_ratio))


class IsochoricNeoHookean(NeoHookean):
    """μ/2 (J^(−2/3) I₁ − 3), with κ the bulk modulus K: the energy of a nearly incompressible silicone."""

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
    """μ/2 (I₁ − 3) − μ (J − 1), with κ = λ + μ: MuJoCo's energy (Smith et al. 2018, ACM Trans. Graph. 37:12)."""

    @property
    def volumetric_modulus_mpa(self) -> float:
        return super().volumetric_modulus_mpa + self.shear_modulus_mpa / 3

    def energy(self, f: Floats, j: Floats) -> Floats:
        return self.shear_modulus_mpa * (((f**2).sum(-1) - 3) / 2 - (j - 1))

    def stress(self, f: Floats, j: Floats, dj: Floats) -> Floats:
        return self.shear_modulus_mpa * (f - dj)

    def tangent(self, f: Floats, j: Floats, dj: Floats, ddj: Floats) -> Floats:
        return self.shear_modulus_mpa * (np.eye(f.shape[-1]) - ddj)
