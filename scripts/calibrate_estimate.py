"""How much error comes with each cause: the coefficients of `gelgap.sim.estimate`, from random scenes.

python scripts/calibrate_estimate.py --first 300 --last 360    # an hour; one that was stopped goes on where it was

Presses are compared with the axisymmetric solver, at draft and at standard; drags at draft with those at standard,
whose own causes are added: the coefficients are those of all meshes. `gelgap benchmark physics --what estimate` takes
scenes 0 to 299; those of Fz and radius that gelgap has are of its presses among 72 to 249 instead, since drags
have no truth of their own; it checks them on the others.
"""

import argparse
import os
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.optimize import nnls

from gelgap.benchmarks.physics.cases import Solver
from gelgap.benchmarks.physics.estimate import random_errors
from gelgap.sim.estimate import CAUSES, ERRORS

KEPT = Path("benchmark-results/estimate-calibration")
SMALLEST_VARIANCE = 1e-8
COVERED = 0.95  # of the true errors are below twice the estimate


def coefficients(rows: pd.DataFrame, error: str) -> tuple[float, ...]:
    """Fit an error's variance by its causes' squares, coefficients ≥ 0, then widen it to cover 95 % of each quality.

    A square of a Gaussian error spreads as its own variance does, by which each scene is weighed.
    """
    causes, square = rows[list(CAUSES)].to_numpy() ** 2, rows[error].to_numpy() ** 2
    variance = np.full(len(rows), square.mean())
    for _ in range(20):
        fitted, _ = nnls(causes / variance[:, None], square / variance)
        variance = np.maximum(causes @ fitted, SMALLEST_VARIANCE)
    shares = pd.Series(square / variance, rows.index).groupby(rows["quality"])
    widened = float(shares.quantile(COVERED).max()) / 4
    return tuple(float(f"{value:.3g}") for value in fitted * widened)


def main() -> None:
    """Print the coefficients."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--first", type=int, default=300)
    parser.add_argument("--last", type=int, default=360)
    chosen = parser.parse_args()
    solver = Solver(os.cpu_count() or 1, KEPT)
    numbers = range(chosen.first, chosen.last)
    rows = random_errors(numbers, ("draft", "standard"), solver, finest="standard")
    rows = rows[rows["converged"] & rows["known"]]
    for error in ERRORS:
        print(f"    {coefficients(rows, error)},  # {error}")


if __name__ == "__main__":
    main()
