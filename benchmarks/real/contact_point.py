"""The contact point of a ball, from synthetic presses to real ones: no labels and few, in drawn and in fitted light."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from gelgap.adapt import ForceModel, Profile, ResultTable
from gelgap.benchmarks.adaptation.jobs import configuration_hash
from gelgap.benchmarks.adaptation.tables import interval
from gelgap.benchmarks.common.records import append_record, read_records
from gelgap.benchmarks.common.tables import write_json
from gelgap.benchmarks.real.ball_sensor import fit_quality, fitted_sensor
from gelgap.benchmarks.real.point_networks import (
    SCRATCH,
    Predicted,
    from_scratch,
    methods_of,
    point_profile,
    trained,
    transferred,
)
from gelgap.benchmarks.real.point_trials import (
    DRAWS,
    FEW,
    NO_LABELS,
    PLAIN_METHODS,
    Errors,
    PlainMethod,
    PointRecord,
    RealPresses,
    errors_of,
    record_of,
)
from gelgap.benchmarks.real.published_sets import BALL_CLONE, LAYOUTS, SERIES, ball_presses
from gelgap.benchmarks.real.synthetic_presses import (
    CALIBRATED,
    DRAWN,
    Amount,
    contact_points,
    press_recipes,
    synthetic_presses,
)
from gelgap.domains import convert
from gelgap.render import Sensor

Key = tuple[str, int, int]
NAME, RECORDS = "gelsight", "points.jsonl"
TARGETS_MM = {NO_LABELS: 0.5, 20: 0.3}
"""The mean distance that a network should stay below, by the number of labelled presses."""
_FITTED_SERIES = SERIES[1]
_COLUMNS = (
    "method",
    "labels",
    "mean, mm",
    "95 % interval",
    "centred, mm",
    "mean error (x, y), mm",
    "time, s",
)


@dataclass(frozen=True)
class Plan:
    """How much is done: the network's profile, the synthetic presses, lights, draws, and numbers of labels."""

    profile: Profile
    amount: Amount
    lights: tuple[str, ...]
    draws: tuple[int, ...]
    few: tuple[int, ...]
    steps_from_scratch: int


QUICK = Plan(point_profile("smoke", 2), Amount(2, 8, 1), (DRAWN,), DRAWS[:2], FEW[:1], 20)
WHOLE = Plan(point_profile("cpu", 20), Amount(24, 64, 8), (DRAWN, CALIBRATED), DRAWS, FEW, 300)


@dataclass(frozen=True)
class Trials:
    """The trials of a plan; `folder` keeps what is finished, `clone` has the pictures that a light is fitted to."""

    plan: Plan
    presses: RealPresses
    clone: Path
    folder: Path

    @cached_property
    def configuration(self) -> str:
        """A hash of all that the trials have in common."""
        synthetic = [recipe.key for recipe in press_recipes(self.plan.amount, None)]
        return configuration_hash(
            self.plan.profile,
            synthetic,
            self.plan.steps_from_scratch,
            self.presses.frames.label_values.tolist(),
        )

    def records(self) -> list[PointRecord]:
        """Do the trials that have no record yet, and return the records of all."""
        path = self.folder / RECORDS
        kept = {r.key: r for r in read_records(path, PointRecord) if r.configuration == self.configuration}
        wanted = []
        for keys, work in self._pieces():
            wanted += keys
            if all(key in kept for key in keys):
                continue
            for found in work():
                key = found.method, found.labels, keys[0][2]
                kept[key] = record_of(self.presses, key, self.configuration, found.points_mm, found.seconds)
                append_record(path, kept[key])
                print(f"{found.method}, {found.labels} labels, draw {key[2]}", flush=True)
        return [kept[key] for key in wanted]

    def _pieces(self) -> Iterator[tuple[list[Key], Callable[[], Iterable[Predicted]]]]:
        """Yield which records a piece of work makes, and the work."""
        few, profile, steps = self.plan.few, self.plan.profile, self.plan.steps_from_scratch
        for draw in self.plan.draws:
            for method in PLAIN_METHODS:
                for count in sorted({NO_LABELS, *few} & set(method.labels)):
                    yield [(method.name, count, draw)], partial(self._plain, method, draw, count)
        for draw in self.plan.draws:
            for light in self.plan.lights:
                keys = [(name, count, draw) for name, count in methods_of(light, few)]
                yield keys, partial(self._transferred, light, draw)
            for count in few:
                learn = partial(from_scratch, self.presses, profile, draw, count, steps)
                yield [(SCRATCH, count, draw)], learn

    def _plain(self, method: PlainMethod, draw: int, count: int) -> Iterator[Predicted]:
        start = time.perf_counter()
        points_mm = method.predict(self.presses, draw, count)
        yield Predicted(method.name, count, points_mm, time.perf_counter() - start)

    def _transferred(self, light: str, draw: int) -> Iterator[Predicted]:
        return transferred(light, self._model(light, draw), self.presses, draw, self.plan.few)

    def _model(self, light: str, draw: int) -> ForceModel:
        fitted = self._fitted() if light == CALIBRATED else None
        synthetic = synthetic_presses(self.folder / light, self.plan.amount, fitted)
        return trained(synthetic, self.plan.profile, draw // 2, self.folder / light)

    def _fitted(self) -> Sensor:
        path = self.folder / "ball-sensor.toml"
        if not path.is_file():
            print(fit_quality(fitted_sensor(ball_presses(self.clone, _FITTED_SERIES), path)))
        return Sensor.load(path)


def run(quick: bool, out_dir: Path, data: Path) -> None:
    """Do the trials that have no record yet, print the table, and write `real-contact-point.json` to `out_dir`."""
    clone, plan = data / NAME, QUICK if quick else WHOLE
    folder = out_dir / "real" / "contact-point" / plan.profile.name
    converted = out_dir / "real" / "balls"
    if not clone.is_dir():
        raise FileNotFoundError(f"{clone} is missing; get it: {BALL_CLONE} {clone}")
    if not converted.is_dir():
        convert(clone, LAYOUTS["ball-presses"], converted)
    presses = RealPresses(contact_points([converted / "ball-presses"]))
    table = point_table(Trials(plan, presses, clone, folder).records(), presses)
    table.show()
    write_json(out_dir / "real-contact-point.json", table)


def point_table(records: Sequence[PointRecord], presses: RealPresses) -> ResultTable:
    """Show each method with each number of labels; a missed target stands first in the note."""
    methods = list(dict.fromkeys((record.labels, record.method) for record in records))
    found = [
        errors_of([record for record in records if (record.labels, record.method) == one])
        for one in sorted(methods, key=lambda one: one[0])
    ]
    draws = len({record.draw for record in records})
    return ResultTable(
        "Contact point of real ball presses: distance from the mark on clips that were not learnt from",
        list(_COLUMNS),
        [
            [
                one.method,
                one.labels,
                f"{one.mean_mm:.3f}",
                interval(one.interval_mm, ".3f"),
                f"{np.nanmean(one.centered_mm):.3f}",
                f"{one.offset_mm[0]:+.2f}, {one.offset_mm[1]:+.2f}",
                f"{one.seconds:.1f}",
            ]
            for one in found
        ],
        f"{_targets(found)} {len(presses.frames)} presses in {len(np.unique(presses.clip))} clips of at most twenty; "
        f"{draws} draws by clip, half of the clips tested in each; marks are whole pixels of 0.1 mm. Labels: marked "
        "presses of the other half; networks with `statistics` see that half's pictures alone. Intervals: bootstrap "
        "over clips and draws. Centred: without the mean of the errors over the tested presses, which takes labels to "
        "know. Time: median, without the training that draws share.",
    )


def _targets(found: Sequence[Errors]) -> str:
    """Return for each target what the best network reaches."""
    said = []
    for labels, target_mm in TARGETS_MM.items():
        networks = [one for one in found if one.labels == labels and " light, " in one.method]
        if not networks:
            continue
        best = min(networks, key=lambda one: one.mean_mm)
        verdict = "missed" if best.mean_mm > target_mm else "reached"
        said.append(
            (
                verdict,
                f"Target of {target_mm} mm with {labels} labels {verdict}: {best.method} has {best.mean_mm:.2f} mm.",
            )
        )
    return " ".join(text for _, text in sorted(said))
