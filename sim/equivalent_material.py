"""Which Stable Neo-Hookean moduli make MuJoCo's gel press like the isochoric neo-Hookean one.

"Neo-Hookean with E and ν" is not one material: the energies agree at small strain and as ν → 1/2, but a press
to a third of a pad's thickness is 4.5 % softer in MuJoCo's form at ν = 0.45. The two moduli are moved so that
force and surface of a press agree as well as two numbers allow, over depths up to that.
`python -m gelgap.benchmarks.calibration.material` derives the coefficients from locking-free axisymmetric solves
of both energies, and checks them on radii, thicknesses, ν and friction that it did not use.
"""

CALIBRATED_POISSON_RATIO = (0.3, 0.5)
# E′/E = 1 + x (a + b x) and ν′ = ν + x (c + d x) with x = 1 − 2ν, as calibrate_material prints them.
MODULUS_COEFFICIENTS = (0.2294, -0.0290)
POISSON_COEFFICIENTS = (0.0452, -0.1176)


def equivalent_material(young_modulus_mpa: float, poisson_ratio: float) -> tuple[float, float]:
    """Return (E′ in MPa, ν′) of the Stable Neo-Hookean energy that stands for the isochoric gel of (E, ν).

    Calibrated for 0.3 ≤ ν < 0.5 and depths up to a third of the thickness and two thirds of the sphere's
    radius; below 0.3 the shift is that of 0.3. It tends to the identity as ν → 1/2. What remains is a trend
    with depth, because E′ cannot be right at small and at large strain together: see docs/physics-reference.md.

    Raises
    ------
    ValueError
        If the modulus is not positive or ν is not in [0, 0.5).
    """
    if not young_modulus_mpa > 0:
        raise ValueError(f"young_modulus_mpa = {young_modulus_mpa!r} must be > 0")
    if not 0 <= poisson_ratio < 0.5:
        raise ValueError(f"poisson_ratio = {poisson_ratio!r} must be in [0, 0.5)")
    x = 1 - 2 * max(poisson_ratio, CALIBRATED_POISSON_RATIO[0])
    a, b = MODULUS_COEFFICIENTS
    c, d = POISSON_COEFFICIENTS
    return young_modulus_mpa * (1 + x * (a + b * x)), max(0.0, poisson_ratio + x * (c + d * x))
