"""`gelgap demo`: the whole chain at its smallest, on two domains, from presses to a report."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from gelgap import adapt, domains
from gelgap.assets.progress import shown_progress
from gelgap.cli import options as opt

if TYPE_CHECKING:
    from gelgap.adapt.result_table import NamedFigure

SOURCE, TARGET = "mb0i0", "wmb1i1"
METHODS = ("source-only", "adabn", "dsan")
PATH, PROFILE, SEED = "smoke-random", "smoke", 0
# Of the source's frames, by Fz, for DSAN: contacts at random are on no grid that would class them.
CLASSES = 10
SAMPLE_DEPTH_MM = 0.6


@dataclass(frozen=True)
class Demo(opt.Command):
    """Generate two small domains, learn force on one, adapt to the other, and write a report; minutes on 2 cores.

    Everything is real: solved contacts, rendered pictures, trained networks. Run again, it reuses finished domains.

    For example:
      gelgap demo
    """

    when_stopped = "finished shards, solves, runs and epochs are kept, run the same command again to go on"
    fills_cache = True

    out: Annotated[Path, opt.output_folder] = Path("demo")
    """Folder for domains, models and report.html."""

    def run(self, started: float) -> None:
        """Generate source and target, train, adapt, write the report and print its tables; finished parts are kept."""
        from gelgap.adapt.report import axis_table, error_table, training_table
        from gelgap.adapt.result_table import write_pages

        print(f"1/3  generating {SOURCE} and {TARGET} on the path {PATH}")
        report = domains.generate(
            (SOURCE, TARGET),
            PATH,
            self.out / "data",
            quality="draft",
            seed=SEED,
            columns=("height_map",),
        )
        print(report)

        print(f"2/3  training on {SOURCE}, adapting to {TARGET} without its labels (profile {PROFILE!r})")
        with shown_progress() as progress:
            runs = adapt.adapt_folders(
                self.out / "data" / SOURCE,
                self.out / "data" / TARGET,
                METHODS,
                profile=adapt.Profile.preset(PROFILE),
                seed=SEED,
                classes_from_force=CLASSES,
                out_dir=self.out / "runs",
                progress=progress,
            )

        print("3/3  writing the report")
        tables = [error_table(runs), axis_table(runs), training_table(runs)]
        figures = [samples(self.out / "data"), scatter(runs)]
        page = write_pages(self.out, "report", headline(runs), tables, figures)
        for table in tables:
            table.show()
        print(f"{headline(runs)}\n\n{time.perf_counter() - started:.0f} s in all; report: {page}")


def headline(runs: "Sequence[adapt.Run]") -> str:
    """Return the report's title: whether adaptation helped and the network learned at all."""
    plain, normalised, adapted = (run.target_test.mean_mae_n for run in runs)
    told = (
        f"DSAN {'beats' if adapted < plain else 'does NOT beat'} source-only on the target: mean error "
        f"{adapted:.3f} N against {plain:.3f} N ({100 * (adapted / plain - 1):+.0f} %); AdaBN, the target's "
        f"normalisation statistics alone, has {normalised:.3f} N"
    )
    if runs[0].source_held_out.mean_mae_n >= 0.5 * runs[0].source_constant_mean.mean_mae_n:
        told += "; source-only did NOT learn: its error on the source is over half the mean's"
    return told


def samples(data: Path) -> "NamedFigure":
    """Draw a contact in both domains: the frame dragged furthest right and down of the tenth nearest to 0.6 mm."""
    import numpy as np
    from matplotlib.figure import Figure

    from gelgap.adapt.result_table import NamedFigure
    from gelgap.render.imaging import difference_picture

    figure = Figure(figsize=(11, 4.8), layout="constrained")
    for row, name in zip(figure.subplots(2, 4), (SOURCE, TARGET), strict=True):
        domain = domains.open_domain(data / name)
        sideways = domain.columns["shear_x_mm"] + domain.columns["shear_y_mm"]
        off_mm = np.abs(domain.columns["depth_mm"] - SAMPLE_DEPTH_MM)
        index = int(np.argmax(np.where(off_mm <= np.quantile(off_mm, 0.1) + 1e-9, sideways, -np.inf)))
        picture = domain.picture(index)
        row[0].imshow(domain.reference)
        row[1].imshow(picture)
        row[2].imshow(difference_picture(picture, domain.reference, 2.0))
        height = row[3].imshow(domain.height_map_mm(index))
        figure.colorbar(height, ax=row[3], label="mm", shrink=0.8)
        for panel, title in zip(row, ("reference", "contact", "difference, ×2", "height"), strict=True):
            panel.set(title=title, xticks=[], yticks=[])
        row[0].set_ylabel(name)
    caption = (
        f"The same commanded contact in both domains, about {SAMPLE_DEPTH_MM} mm deep and dragged sideways"
    )
    return NamedFigure("samples", caption, figure)


def scatter(runs: "Sequence[adapt.Run]") -> "NamedFigure":
    """Draw predicted against true force on the target."""
    from gelgap.adapt.report import force_scatter
    from gelgap.adapt.result_table import NamedFigure

    arrays = {run.method: adapt.load_predictions(run) for run in runs}
    predicted = {method: own["target_predicted_n"] for method, own in arrays.items()}
    figure = force_scatter(arrays[METHODS[0]]["target_true_n"], predicted)
    return NamedFigure("scatter", f"Predicted against true force, test frames of {TARGET}", figure)
