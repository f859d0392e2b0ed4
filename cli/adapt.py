"""`gelgap adapt`: train on one domain, adapt to another, and report the error."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from gelgap import adapt, domains
from gelgap.assets.names import quoted, unknown_name
from gelgap.cli import options as opt

CONSTANT_MEAN = "constant-mean"


def check_methods(names: tuple[str, ...]) -> None:
    """Check names of methods, one at least, before torch is loaded; classes of one's own are checked later."""
    known = adapt.method_names()
    if not names:
        raise ValueError(f"name at least one; known: {', '.join(known)}")
    for name in names:
        if ":" not in name and name not in known:
            raise ValueError(unknown_name("method", name, known))


def label_ranges(texts: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    """Return ranges by label, of texts such as `fz_n=-30:0`; a ValueError says what is wrong with one."""
    named = []
    for text in texts:
        try:
            name, bounds = text.split("=")
            low, high = map(float, bounds.split(":"))
        except ValueError:
            raise ValueError(
                f"{quoted(text)} must be a label, its lower and its upper bound, as fz_n=-30:0"
            ) from None
        named.append((name, (low, high)))
    labels = domains.Labels(tuple(name for name, _ in named), tuple(bounds for _, bounds in named))
    return dict(zip(labels.names, labels.ranges, strict=True))


@dataclass(frozen=True)
class Adapt(opt.Command):
    """Learn force on the source domain, adapt to the target's pictures without its labels, evaluate on held-out frames.

    Stage 1 (source only) is shared by all methods with the same source, profile and seed. A finished run is not
    repeated, an interrupted one goes on from its last epoch.

    For example:
      gelgap adapt --source data/mb0i0 --target data/wmb1i1 --method dsan --profile cpu --classes from-force 20
      gelgap adapt --source data/mb0i0 --target data/wmb1i1 --method dan --labels fz_n --range fz_n=-4:0 --out runs
      gelgap adapt --source data/mb0i0 --target data/wmb1i1 --method adabn dann --input calibrated --out colour-runs
    """

    when_stopped = "finished runs and epochs are kept, run the same command again to go on"

    source: tuple[Path, ...]
    """Folder of the source domain, or several that are trained on together."""
    target: Path
    """Folder of the target domain."""
    method: Annotated[tuple[str, ...], check_methods] = ("source-only", "dsan")
    """Adaptation methods, or your own as module:Class or file.py:Class; a wrong name lists the known ones."""
    profile: opt.ProfileName = "smoke"
    input: Annotated[str | None, opt.optional("NAME", "the profile's")] = None
    """What the network is shown: pictures, standardised, calibrated, grey, markers or pretrained (with --weights)."""
    backbone: Annotated[str | None, opt.optional("NAME", "the profile's")] = None
    """The feature extractor: resnet18, resnet50, or your own as file.py:make_backbone."""
    labels: Annotated[
        tuple[str, ...] | None, opt.optional("NAME ...", "the axes of the force that both domains have")
    ] = None
    """What is predicted: fx_n fy_n fz_n, mx_nmm my_nmm mz_nmm, x_mm y_mm, depth_mm."""
    range: Annotated[
        tuple[str, ...] | None, opt.optional("NAME=LOW:HIGH ...", "as the data declare it"), label_ranges
    ] = None
    """Ranges by which labels of both domains are normalised, as fz_n=-30:0."""
    split_by: Annotated[str | None, opt.optional("COLUMN", "the profile's")] = None
    """Split both domains at random, by contact point, as given, or by a column such as clip: whole groups."""
    stratify: Annotated[str | None, opt.optional("COLUMN")] = None
    """Give every part of the split its share of each value of a column, such as object."""
    classes: Annotated[
        tuple[Literal["from-force"], int] | None, opt.optional("from-force COUNT", "the source's own")
    ] = None
    """Contact classes of the source for methods that need them: this many of equal size, by Fz."""
    seed: opt.Seed = 0
    """Seed of weights, splits and batches."""
    weights: Annotated[Path | None, opt.optional("PATH", "from scratch")] = None
    """Start from a gelgap checkpoint, or from ImageNet weights as torchvision saves them."""
    out: Annotated[Path, opt.output_folder] = Path("runs")
    """Folder that gets the checkpoints, predictions and run records."""

    def run(self, started: float) -> None:
        """Train, adapt, print one line per method."""
        changes = {"input": self.input, "split_by": self.split_by, "stratify_by": self.stratify}
        changes["backbone"] = self.backbone and adapt.use_backbone(self.backbone)
        profile = opt.named(adapt.Profile, self.profile).replace(
            **{name: value for name, value in changes.items() if value is not None}
        )
        with adapt.console_progress() as progress:
            runs = adapt.adapt_folders(
                self.source,
                self.target,
                self.method,
                profile=profile,
                seed=self.seed,
                labels=self.labels,
                ranges=self.range and label_ranges(self.range),
                classes_from_force=self.classes and self.classes[1],
                weights=self.weights,
                out_dir=self.out,
                progress=progress,
            )
        print(_table(runs))
        if failed := [run.method for run in runs if run.problem]:
            raise RuntimeError(f"{len(failed)} of {len(runs)} methods failed: {', '.join(failed)}")


def _table(runs: "Sequence[adapt.Run]") -> str:
    """Return each run's error, if it did not fail, beside rules and oracles without a network, and what went wrong."""
    from gelgap.adapt.evaluation import errors_text, worse_than_constant

    done = [run for run in runs if run.method != CONSTANT_MEAN and not run.problem]
    errors = {"constant mean": runs[0].target_constant_mean} | runs[0].baselines | runs[0].oracles
    errors |= {run.method: run.target_test for run in done}
    lines = [f"{runs[0].group}, target test frames", errors_text(errors)]
    lines += [f"{run.method}: {note}" for run in done if (note := worse_than_constant(run.target_test))]
    lines += [f"{run.method}: {run.problem}" for run in runs if run.problem]
    lines += [
        f"{run.method}: {run.skipped_steps} steps skipped for losses that were not finite"
        for run in runs
        if run.skipped_steps
    ]
    lines += [f"no picture shows: {note}" for note in runs[0].unseen]
    return "\n".join(lines)
