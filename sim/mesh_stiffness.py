"""Moduli that make a mesh's tetrahedra respond as the material does: linear tetrahedra are a little too stiff.

Against locking-free solutions of the same energy a mesh of one size is too stiff by a factor that hardly depends
on depth, and not on the scene's size, since meshes scale with the contact. It grows with the bulk modulus, as
what is left of volumetric locking does: factor = 1 + a + b / (1 − 2ν), with a and b of `MeshSize`.
`python -m gelgap.benchmarks.calibration.mesh` derives a and b, and checks them on radii, thicknesses, ν and friction
that it did not use.

Above ν = 0.49 locking rises steeply and the material hardly changes: from 0.49 to 0.499 the axisymmetric solver's
force rises by 1.7 % a hundredth of ν (1.5 without friction, 1.6 to 2.2 without slip), and the membrane moves by some
5 µm rms at a third of the thickness. There the mesh gets ν = 0.49 and a modulus that has that rise.
"""

LARGEST_POISSON_RATIO = 0.49
FORCE_RISE_PER_POISSON = 1.7


def mesh_moduli(
    young_modulus_mpa: float, poisson_ratio: float, stiffness: tuple[float, float]
) -> tuple[float, float]:
    """Return (E in MPa, ν) to give a mesh of that stiffness (a, b) so that it acts as a material of the given moduli.

    Both pairs are those of MuJoCo's Stable Neo-Hookean energy.
    """
    excess = max(0.0, poisson_ratio - LARGEST_POISSON_RATIO)
    poisson_ratio -= excess
    a, b = stiffness
    factor = 1 + a + b / (1 - 2 * poisson_ratio)
    return young_modulus_mpa * (1 + FORCE_RISE_PER_POISSON * excess) / factor, poisson_ratio
