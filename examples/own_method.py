"""
Your own adaptation method
==========================

Align the mean features of both domains: one class, named with its file.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
from torch import Tensor

from gelgap.adapt import Activations, Method, adapt_folders


class MeanMatching(Method):
    """Squared distance of the batch means: the simplest maximum mean discrepancy, with a linear kernel."""

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        return (source.features.mean(dim=0) - target.features.mean(dim=0)).square().sum()


def main(source: Path, target: Path, profile: str = "smoke") -> None:
    runs = adapt_folders(source, target, ("source-only", f"{__file__}:MeanMatching"), profile=profile)
    errors_n = {run.method: run.target_test.mean_mae_n for run in runs if run.target_test is not None}
    for method, error_n in errors_n.items():
        print(f"{method:<24} mean error on the target {error_n:.3f} N")
    axes = plt.figure(figsize=(5, 3), layout="constrained").subplots()
    axes.bar(list(errors_n), list(errors_n.values()))
    axes.set_ylabel("mean error on the target, N")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]) if len(sys.argv) > 2 else (Path("data/mb0i0"), Path("data/wmb1i1")))
    plt.show()
