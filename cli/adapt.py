"""`gelgap adapt`: train on one domain, adapt to another, and report the error."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from gelgap.cli.arguments import load_profile, optional
from gelgap.cli.rules import SEED, DataSet, InputFile, OneOf, OutputFolder, Preset

if TYPE_CHECKING:
    from gelgap.adapt import Run

CONSTANT_MEAN = "constant-mean"


@dataclass(frozen=True)
class MethodNames:
    """Names of methods, one at least; what is wrong with a class of one's own shows when it is loaded."""

    def problem(self, value: tuple[str, ...]) -> str | None:
        """Return what is wrong with the names."""
        from gelgap.adapt import method_names

        known = [name for name in value if ":" not in name]
        return OneOf(method_names, several=True).problem(tuple(known)) if known or not value else None


@dataclass(frozen=True)
class Adapt:
    """Learn force on the source domain, adapt to the target's pictures without its labels, evaluate on held-out frames.

    Stage 1 (source only) is shared by all methods with the same source, profile and seed. A finished run is not
    repeated, an interrupted one goes on from its last epoch.

    For example:
      gelgap adapt --source data/mb0i0 --target data/wmb1i1 --method source-only dsan --profile cpu --out runs
    """

    when_stopped: ClassVar[str] = "finished runs and epochs are kept, run the same command again to go on"

    source: Annotated[Path, DataSet()]
    """Folder of the source domain."""
    target: Annotated[Path, DataSet()]
    """Folder of the target domain."""
    method: Annotated[tuple[str, ...], MethodNames()] = ("source-only", "dsan")
    """Adaptation methods, or your own as module:Class or file.py:Class; a wrong name lists the known ones."""
    profile: Annotated[str, Preset("profiles")] = "smoke"
    """Hyperparameters: a preset (see: gelgap presets profiles) or a TOML file."""
    seed: Annotated[int, SEED] = 0
    """Seed of weights, splits and batches."""
    weights: Annotated[Path | None, optional("PATH", "from scratch"), InputFile("a checkpoint")] = None
    """Start from a gelgap checkpoint, or from ImageNet weights as torchvision saves them."""
    out: Annotated[Path, OutputFolder()] = Path("runs")
    """Folder that gets the checkpoints, predictions and run records."""

    def run(self, started: float) -> None:
        """Train, adapt, print one line per method."""
        profile = load_profile(self.profile)
        from gelgap.adapt import adapt_folders, console_progress

        with console_progress() as progress:
            runs = adapt_folders(
                self.source,
                self.target,
                self.method,
                profile=profile,
                seed=self.seed,
                weights=self.weights,
                out_dir=self.out,
                progress=progress,
            )
        print(_table(runs))


def _table(runs: "Sequence[Run]") -> str:
    """Return the error of each run beside that of the constant mean, and what went wrong."""
    lines = [
        f"{runs[0].group}, target test frames",
        f"{'MAE in N':<16} {'Fx':>7} {'Fy':>7} {'Fz':>7} {'mean':>7}   {'R² Fx':>6} {'Fy':>6} {'Fz':>6}",
    ]
    constant = ("constant mean", runs[0].target_constant_mean)
    methods = [(run.method, run.target_test) for run in runs if run.method != CONSTANT_MEAN]
    for name, error in [constant, *methods]:
        errors = " ".join(f"{value:7.4f}" for value in (*error.mae_n, error.mean_mae_n))
        lines.append(f"{name:<16} {errors}   " + " ".join(f"{value:6.2f}" for value in error.r2))
    for run in runs:
        if run.problem:
            lines.append(f"{run.method}: {run.problem}")
        if run.skipped_steps:
            lines.append(f"{run.method}: {run.skipped_steps} steps skipped for losses that were not finite")
    return "\n".join(lines)
