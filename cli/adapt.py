"""`gelgap adapt`: train on one domain, adapt to another, and report the error."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Adapt:
    """Learn force on the source domain, adapt to the target's pictures without its labels, evaluate on held-out frames.

    Stage 1 (source only) is shared by all methods with the same source, profile and seed. A finished run is not
    repeated, an interrupted one goes on from its last epoch.

    Example: gelgap adapt --source data/mb0i0 --target data/wmb1i1 --method source-only dsan --profile cpu --out runs
    """

    source: Path
    """Folder of the source domain."""
    target: Path
    """Folder of the target domain."""
    method: tuple[str, ...] = ("source-only", "dsan")
    """Adaptation methods; a wrong name lists the known ones."""
    profile: str = "smoke"
    """Hyperparameters: smoke (seconds), cpu, or paper (ResNet-50 at 256 px; wants a GPU)."""
    seed: int = 0
    """Seed of weights, splits and batches."""
    weights: Path | None = None
    """Start from a gelgap checkpoint, or from ImageNet weights as torchvision saves them."""
    out: Path = Path("runs")
    """Folder that gets the checkpoints, predictions and run records."""

    def run(self, started: float) -> None:
        """Train, adapt, print one line a method."""
        from gelgap.adapt import adapt_folders, console_progress

        with console_progress() as progress:
            runs = adapt_folders(
                self.source,
                self.target,
                self.method,
                self.profile,
                self.seed,
                weights=self.weights,
                out_dir=self.out,
                progress=progress,
            )
        constant = runs[0].target_constant_mean
        head = (
            f"{'MAE in N':<16} {'Fx':>7} {'Fy':>7} {'Fz':>7} {'mean':>7}   {'R² Fx':>6} {'Fy':>6} {'Fz':>6}"
        )
        print(f"{runs[0].group}, target test frames\n{head}")
        for name, error in [("constant mean", constant), *((run.method, run.target_test) for run in runs)]:
            errors = " ".join(f"{value:7.4f}" for value in (*error.mae_n, error.mean_mae_n))
            print(f"{name:<16} {errors}   " + " ".join(f"{value:6.2f}" for value in error.r2))
        for run in runs:
            if run.problem:
                print(f"{run.method}: {run.problem}")
            if run.skipped_steps:
                print(f"{run.method}: {run.skipped_steps} steps skipped for losses that were not finite")
