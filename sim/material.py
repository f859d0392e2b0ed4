"""The gel's elastic moduli, and those that MuJoCo's energy and a mesh need in order to act as the gel does."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Moduli:
    """The two moduli of an isotropic solid at small strain; ValueError for E ≤ 0 or ν outside of [0, 0.5)."""

    young_modulus_mpa: float
    poisson_ratio: float

    def __post_init__(self) -> None:
        if not self.young_modulus_mpa > 0:
            raise ValueError(f"young_modulus_mpa = {self.young_modulus_mpa!r} must be > 0")
        if not 0 <= self.poisson_ratio < 0.5:
            raise ValueError(f"poisson_ratio = {self.poisson_ratio!r} must be in [0, 0.5)")

    @property
    def shear_mpa(self) -> float:
        """Return μ."""
        return self.young_modulus_mpa / (2 * (1 + self.poisson_ratio))

    @property
    def lame_mpa(self) -> float:
        """Return λ, Lamé's first parameter."""
        young, poisson = self.young_modulus_mpa, self.poisson_ratio
        return young * poisson / ((1 + poisson) * (1 - 2 * poisson))


# `scripts/calibrate_material.py` prints these coefficients of `equivalent_moduli`.
SMALLEST_CALIBRATED_POISSON_RATIO = 0.3
MODULUS_COEFFICIENTS = (0.2294, -0.0290)
POISSON_COEFFICIENTS = (0.0452, -0.1176)

# Above this ν, meshes of linear tetrahedra lock steeply while the gel itself hardly changes: its force rises by 1.7 %
# per hundredth of ν (1.5 without friction, 1.6 to 2.2 without slip), and the membrane moves by some 5 µm rms at a depth
# of a third of the thickness. So meshes get this ν at most, and a modulus that follows that rise.
LARGEST_POISSON_RATIO = 0.49
FORCE_RISE_PER_POISSON = 1.7


def equivalent_moduli(isochoric: Moduli) -> Moduli:
    """Return the moduli with which MuJoCo's Stable Neo-Hookean gel presses like an isochoric one.

    "Neo-Hookean with E and ν" is not one material: the energies agree at small strain and as ν → 1/2, but a press to a
    third of a pad's thickness is 4.5 % softer in MuJoCo's form at ν = 0.45. With x = 1 − 2ν, E′/E = 1 + x (a + b x) and
    ν′ = ν + x (c + d x) make force and surface of a press agree as well as two numbers allow.

    Calibrated on locking-free axisymmetric solves of both energies, for 0.3 ≤ ν < 0.5 and depths up to a third of the
    thickness and two thirds of the sphere's radius; below 0.3 the shift is that of 0.3. What remains is a trend with
    depth, because E′ cannot be right at small and at large strain together: see docs/physics-reference.md.
    """
    x = 1 - 2 * max(isochoric.poisson_ratio, SMALLEST_CALIBRATED_POISSON_RATIO)
    a, b = MODULUS_COEFFICIENTS
    c, d = POISSON_COEFFICIENTS
    return Moduli(
        isochoric.young_modulus_mpa * (1 + x * (a + b * x)),
        max(0.0, isochoric.poisson_ratio + x * (c + d * x)),
    )


def mesh_moduli(gel: Moduli, stiffness: tuple[float, float], contact_width: float = 1.0) -> Moduli:
    """Return the moduli with which a mesh of that stiffness (a, b) acts as the gel; both in MuJoCo's energy.

    Linear tetrahedra are too stiff by a factor that hardly depends on depth, nor on the scene's size, since meshes
    scale with the contact. It grows with the bulk modulus, as what is left of volumetric locking does:
    1 + a + b / (1 − 2ν). `scripts/calibrate_mesh.py` derives a and b against locking-free solutions
    of the same energy, and checks them on radii, thicknesses, ν and friction that it did not use. Under a contact that
    is `contact_width` times as wide as the gel is thick, the excess is smaller by the root of that.
    """
    excess = max(0.0, gel.poisson_ratio - LARGEST_POISSON_RATIO)
    poisson_ratio = gel.poisson_ratio - excess
    a, b = (coefficient / math.sqrt(contact_width) for coefficient in stiffness)
    factor = 1 + a + b / (1 - 2 * poisson_ratio)
    return Moduli(gel.young_modulus_mpa * (1 + FORCE_RISE_PER_POISSON * excess) / factor, poisson_ratio)
