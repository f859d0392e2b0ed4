"""How much error comes with each cause: the coefficients of `gelgap.sim.estimate`, from random scenes.

python scripts/calibrate_estimate.py --first 300 --last 420    # some hours; one that was stopped goes on where it was

`gelgap benchmark physics --what estimate` takes scenes 0 to 299, so that it checks what was not calibrated on.
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
    """Fit an error's variance by the squares of its causes, coefficients ≥ 0, then widen it until 95 % are covered.

    A square of a Gaussian error spreads as its own variance does, by which each scene is weighed.
    """
    causes, square = rows[list(CAUSES)].to_numpy() ** 2, rows[error].to_numpy() ** 2
    variance = np.full(len(rows), square.mean())
    for _ in range(20):
        fitted, _ = nnls(causes / variance[:, None], square / variance)
        variance = np.maximum(causes @ fitted, SMALLEST_VARIANCE)
    widened = float(np.quantile(square / variance, COVERED)) / 4
    return tuple(float(f"{value:.3g}") for value in fitted * widened)


def main() -> None:
    """Print the coefficients by quality and mesh."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--first", type=int, default=300)
    parser.add_argument("--last", type=int, default=420)
    parser.add_argument("--quality", nargs="+", default=["draft", "standard"])
    chosen = parser.parse_args()
    solver = Solver(os.cpu_count() or 1, KEPT)
    rows = random_errors(range(chosen.first, chosen.last), chosen.quality, solver)
    for (quality, mesh), own in rows[rows["converged"]].groupby(["quality", "mesh"], sort=False):
        print(f'    ("{quality}", "{mesh}"): (')
        for error in ERRORS:
            print(f"        {coefficients(own, error)},  # {error}, {len(own)} poses")
        print("    ),")


if __name__ == "__main__":
    main()
