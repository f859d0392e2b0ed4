"""`gelgap adapt`: train on one domain, adapt to another, and report the error."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Literal

from gelgap import adapt
from gelgap.assets.progress import shown_progress
from gelgap.cli import options as opt
from gelgap.cli.keys import Meanings, Set, given
from gelgap.cli.label_ranges import label_ranges

CONSTANT_MEAN = "constant-mean"
SELECTION = "selection.csv"


def check_methods(names: tuple[str, ...]) -> None:
    """Check names of methods, one at least, before torch is loaded; classes of one's own are checked later."""
    from gelgap.adapt.methods.registry import check_name

    if not names:
        raise ValueError(f"name at least one; known: {', '.join(adapt.method_names())}")
    for name in names:
        check_name(name)


def check_selector(name: str) -> None:
    """Check the name of a selector."""
    from gelgap.adapt.selection import find_selector

    find_selector(name)


def profile_keys() -> Meanings:
    """Return the keys of a training profile."""
    from gelgap.adapt.profile import Profile

    left_out = ("name", "settings")
    return {
        name: field.description or "" for name, field in Profile.model_fields.items() if name not in left_out
    }


@dataclass(frozen=True)
class Adapt(opt.Command):
    """Learn force on the source domain, adapt to the target's pictures without its labels, evaluate on held-out frames.

    Stage 1 (source only) is shared by all methods with the same source, profile and seed. A finished run is not
    repeated, an interrupted one goes on from its last epoch. For a target without labels no errors are printed, but
    how far its features are from the source's, and what is predicted.

    For example:
      gelgap adapt --source data/mb0i0 --target data/wmb1i1 --method dsan --profile cpu --classes from-force 20
      gelgap adapt --source data/mb0i0 --target data/wmb1i1 --method dan --labels fz_n --range fz_n=-4:0 --out runs
      gelgap adapt --source data/mb0i0 --target data/wmb1i1 --method adabn dann --set input=standardised --out std-runs
      gelgap adapt --source data/mb0i0 --target data/wmb1i1 --method adabn dann --select feature-mmd --out chosen
    """

    former = MappingProxyType(
        {
            "--backbone": opt.Former("0.3.0", "write --set backbone=…"),
        }
    )

    when_stopped = "finished runs and epochs are kept, run the same command again to go on"

    source: tuple[Path, ...]
    """Folder of the source domain, or several that are trained on together."""
    target: tuple[Path, ...]
    """Folder of the target domain, which may hold pictures alone; or several that are adapted to one by one."""
    method: Annotated[tuple[str, ...], check_methods] = ("source-only", "dsan")
    """Adaptation methods, or your own as FILE.py:CLASS; a wrong name lists the known ones."""
    profile: tuple[opt.ProfileName, ...] = ("smoke",)
    set: Set = ()
    """Values that differ from the profile's, such as input=calibrated or backbone=resnet50; all keys are listed above.
    The file of a backbone of your own is run."""
    labels: Annotated[
        tuple[str, ...] | None, opt.optional("NAME ...", "the axes of the force that both domains have")
    ] = None
    """What is predicted: fx_n fy_n fz_n, mx_nmm my_nmm mz_nmm, x_mm y_mm, depth_mm."""
    range: Annotated[
        tuple[str, ...] | None, opt.optional("NAME=LOW:HIGH ...", "as the data declare it"), label_ranges
    ] = None
    """Ranges by which labels of both domains are normalised, as fz_n=-30:0."""
    classes: Annotated[
        tuple[Literal["from-force"], int] | None, opt.optional("from-force COUNT", "the source's own")
    ] = None
    """Contact classes of the source for methods that need them: this many of equal size, by Fz."""
    seed: opt.Seed = 0
    """Seed of weights, splits and batches."""
    weights: Annotated[Path | None, opt.optional("PATH", "from scratch")] = None
    """Start from a gelgap checkpoint, or from ImageNet weights as torchvision saves them."""
    select: Annotated[str | None, opt.optional("NAME"), check_selector] = None
    """Choose a run for each target without its labels, by feature-mmd or source-risk; the scores are written to
    selection.csv."""
    out: Annotated[Path, opt.output_folder] = Path("runs")
    """Folder that gets the checkpoints, predictions and run records."""

    @classmethod
    def keys(cls) -> dict[str, Meanings]:
        return {"profile": profile_keys()}

    def run(self, started: float) -> None:
        """Train, adapt, print a table for each target, with a line per method and profile."""
        changes = given(self.set, self.keys())["profile"]
        if "backbone" in changes:
            changes["backbone"] = adapt.use_backbone(str(changes["backbone"]))
        profiles = [adapt.Profile.named(name).replace(**changes) for name in self.profile]
        with shown_progress() as progress:
            runs = adapt.adapt_folders(
                self.source,
                self.target,
                self.method,
                profile=profiles,
                seed=self.seed,
                labels=self.labels,
                ranges=self.range and label_ranges(self.range),
                classes_from_force=self.classes and self.classes[1],
                weights=self.weights,
                out_dir=self.out,
                progress=progress,
            )
        for group in dict.fromkeys(run.group for run in runs):
            _show([run for run in runs if run.group == group])
        if self.select is not None:
            self._select(runs)
        if failed := [run.method for run in runs if run.problem]:
            raise RuntimeError(f"{len(failed)} of {len(runs)} methods failed: {', '.join(failed)}")

    def _select(self, runs: "Sequence[adapt.Run]") -> None:
        """Write the scores of all runs, print them, and name the run that is chosen for each target."""
        from gelgap.adapt.report import selection_table
        from gelgap.adapt.result_table import ResultTable
        from gelgap.assets.whole_file import write_whole

        table = selection_table(runs, self.select)
        write_whole(self.out / SELECTION, table.to_csv(index=False).encode())
        title = f"Scores without labels, less is better; chosen by {self.select}"
        ResultTable.of(title, table.drop(columns="folder")).show()
        for row in table[table["chosen"]].itertuples():
            print(f"{row.group}: {row.method}, profile {row.profile}, is chosen: {self.out / row.folder}")
        print(f"wrote {self.out / SELECTION}")


def _show(runs: "Sequence[adapt.Run]") -> None:
    """Print the errors on a target beside rules and oracles without a network, or what is known without its labels."""
    from gelgap.adapt.evaluation import errors_text, worse_than_constant
    from gelgap.adapt.report import label_free_tables, method_titles

    titles = method_titles(runs)
    first = runs[0]
    if first.target_test is None:
        for table in label_free_tables(runs):
            table.show()
    else:
        done = {
            titles[run.key]: run.target_test
            for run in runs
            if not run.problem and run.method != CONSTANT_MEAN
        }
        rules = {"constant mean": first.target_constant_mean} | first.baselines | first.oracles
        print(f"{first.group}, {first.target_test.n} target test frames")
        print(errors_text(rules | done))
        for title, errors in done.items():
            if note := worse_than_constant(errors):
                print(f"{title}: {note}")
        for run in runs:
            if run.problem:
                print(f"{titles[run.key]}: {run.problem}")
    for run in runs:
        if run.skipped_steps:
            print(f"{titles[run.key]}: {run.skipped_steps} steps skipped for losses that were not finite")
    for note in first.unseen:
        print(f"no picture shows: {note}")
