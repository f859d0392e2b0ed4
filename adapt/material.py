"""A gel of another Young's modulus: forces of a trained network in its units, without training.

At equal dent, and equal friction, Poisson's ratio and thickness, every force and torque is proportional to the modulus,
and no picture shows it. So a ratio of moduli corrects a network for all contacts and all axes; it is stated, or found
from a few known loads along one axis. What it leaves wrong where the rest of the gel differs is in docs/results.
"""

import numpy as np
from numpy.typing import ArrayLike

from gelgap.adapt.model import AffineCorrection, ForceModel

_UNITS = ("N", "N·mm")
# Of the largest expected load: loads that are out of order by more are not of one gel.
_OUT_OF_ORDER = 0.1


def fit_modulus_ratio(measured_n: ArrayLike, expected_n: ArrayLike) -> tuple[float, float]:
    """Return the modulus of a gel over that of the source's gel, and its standard error, from a few loads (n,), N.

    A line through 0 by least squares: large loads count most.

    Parameters
    ----------
    measured_n
        Fz of each load on the gel.
    expected_n
        Fz that the same dents take in the source's gel: what a network trained on it predicts for their pictures, or
        its force–depth curve at their depths. Depths are dents: what the rig itself gives way, F over its stiffness,
        is taken off.

    Raises
    ------
    ValueError
        If there are fewer than two loads, one is not finite or not of the sign of what is expected, or a larger load
        stands where much less is expected.
    """
    measured, expected = np.asarray(measured_n, float), np.asarray(expected_n, float)
    if measured.ndim != 1 or measured.shape != expected.shape or len(measured) < 2:
        raise ValueError(
            f"measured loads {measured.shape} and expected ones {expected.shape}: two lists of one length are needed, "
            "of two loads or more"
        )
    for number, pair in enumerate(zip(measured, expected, strict=True), start=1):
        if not np.isfinite(pair).all() or pair[0] * pair[1] <= 0:
            raise ValueError(
                f"load {number}: {pair[0]:g} N is measured and {pair[1]:g} N expected; both must be finite, not 0, and "
                "of one sign (Fz of a press is negative)"
            )
    order = np.lexsort((abs(expected), abs(measured)))
    sizes = abs(expected)[order]
    short = np.maximum.accumulate(sizes) - sizes
    if short.max() > _OUT_OF_ORDER * sizes.max():
        number = order[short.argmax()]
        raise ValueError(
            f"load {number + 1}: {measured[number]:g} N is measured where {expected[number]:g} N is expected, but a "
            "smaller load stands where more is expected: force must rise with depth"
        )
    square = float(expected @ expected)
    ratio = float(measured @ expected) / square
    variance = float(np.square(measured - ratio * expected).sum()) / (len(measured) - 1)
    return ratio, (variance / square) ** 0.5


def with_modulus_ratio(model: ForceModel, ratio: float) -> ForceModel:
    """Return the model for a gel of `ratio` times the modulus: each force and torque is `ratio` times what it was.

    Saved, it serves `gelgap predict` and `gelgap export-model`.

    Raises
    ------
    ValueError
        If the ratio is not finite and above 0, or the model predicts no force.
    """
    if not (np.isfinite(ratio) and ratio > 0):
        raise ValueError(f"ratio of moduli = {ratio:g}: must be finite and above 0")
    scales = [unit in _UNITS for _, unit in model.labels.quantities]
    if not any(scales):
        raise ValueError(f"it predicts {', '.join(model.labels.names)}: no force that a modulus would scale")
    gain = tuple(float(ratio) if scaled else 1.0 for scaled in scales)
    return model.corrected(AffineCorrection(gain, (0.0,) * len(gain)))
