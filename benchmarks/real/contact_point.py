"""The contact point of a ball, from synthetic presses to real ones: no labels and few, in drawn and in fitted light.

A draw deals the clips, twenty successive presses each, to two halves: labels and unlabelled pictures come from one, the
other is tested. Draws come in pairs that exchange the halves, so that every clip is tested equally often. A network
sees a window around what a press changes, and says how far from there the contact point is: one that sees the whole
picture must tell a place to a hundredth of the view; in a window it is a tenth.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from gelgap.adapt import (
    ForceModel,
    Profile,
    ResultTable,
    Stage1,
    affine_correction,
    fine_tune,
    train_source,
    with_statistics_of,
)
from gelgap.benchmarks.adaptation.study import configuration_of
from gelgap.benchmarks.common import (
    Results,
    Setting,
    bootstrap,
    mean_of,
    result_table,
    run_missing,
    write_json,
)
from gelgap.benchmarks.real.ball_sensor import (
    MM_PER_SYNTHETIC_PX,
    SYNTHETIC_PX,
    center_of_change_px,
    contact_points,
    fitted_sensor,
    level_point_px,
    press_recipes,
)
from gelgap.benchmarks.real.published_sets import MM_PER_PX, converted_clone
from gelgap.benchmarks.real.sessions import clip_means, clip_table
from gelgap.domains import ArrayFrames, LabelledFrames, Labels, generate_recipes, with_labels

DRAWN, CALIBRATED = "drawn", "calibrated"
"""The light of synthetic presses."""
SCRATCH = "network from scratch"
AS_TRAINED, STATISTICS, CORRECTED, TUNED = "as trained", "statistics", "affine correction", "fine-tuned"
NO_LABELS, FEW = (0,), (5, 20, 100)
WINDOW_PX = 64
REACH_MM = 4.0
"""A contact point lies no farther from the window's centre, along x and along y."""
_LIGHT = " light, "
_WINDOW_LABELS = Labels.of({"x_mm": (-REACH_MM, REACH_MM), "y_mm": (-REACH_MM, REACH_MM)})
_CENTER = ("center_x_mm", "center_y_mm")
_NO_CHANGE = 128
_COPIES, _JITTER_MM = 2, 1.5
_LEVEL_RADIUS_PX = 16.0


def windows_of(frames: LabelledFrames, copies: int = 1, jitter_mm: float = 0.0) -> LabelledFrames:
    """Return windows around the centroid of each picture's change, labelled with the contact point from their centre.

    With copies, as many windows of each picture, put beside the centroid at random. They are cut at whole pixels;
    beyond the picture nothing changes.
    """
    references = frames.references_at(SYNTHETIC_PX).astype(np.int16)
    pairs = zip(frames.images(SYNTHETIC_PX), frames.reference_id, strict=True)
    changes = [picture - references[reference] for picture, reference in pairs]
    which, middle_px = np.tile(np.arange(len(frames)), copies), (np.array(SYNTHETIC_PX) - 1) / 2
    beside_mm = np.random.default_rng(0).uniform(-jitter_mm, jitter_mm, (len(which), 2))
    wanted_mm = (np.array([*map(center_of_change_px, changes)]) - middle_px)[which] * MM_PER_SYNTHETIC_PX
    wanted_px = (wanted_mm + beside_mm) / MM_PER_SYNTHETIC_PX + middle_px
    first_px = np.round(wanted_px - (WINDOW_PX - 1) / 2).astype(int)
    centers_mm = (first_px + (WINDOW_PX - 1) / 2 - middle_px) * MM_PER_SYNTHETIC_PX

    margin, cut = (WINDOW_PX, WINDOW_PX), []
    for press, (x, y) in zip(which, first_px + WINDOW_PX, strict=True):
        padded = np.pad(changes[press], (margin, margin, (0, 0)))
        cut.append(padded[y : y + WINDOW_PX, x : x + WINDOW_PX])
    pictures = np.clip(_NO_CHANGE + np.array(cut), 0, 255).astype(np.uint8)
    reference = np.full(pictures.shape[1:], _NO_CHANGE, np.uint8)
    points_mm = np.stack([frames.columns[name][which] for name in _WINDOW_LABELS.names], axis=1)
    names = (*_WINDOW_LABELS.names, *_CENTER)
    columns = dict(zip(names, (*(points_mm - centers_mm).T, *centers_mm.T), strict=True))
    return with_labels(ArrayFrames(frames.name, pictures, reference, None, **columns), _WINDOW_LABELS)


def with_point(windows: LabelledFrames) -> LabelledFrames:
    """Return the windows whose contact point is within reach of their centre."""
    return windows.take(np.flatnonzero(np.abs(windows.label_values).max(axis=1) < REACH_MM))


def centers_of(windows: LabelledFrames) -> np.ndarray:
    """Return the centres of windows (n, 2) from the middle of the view, mm."""
    return np.stack([windows.columns[name] for name in _CENTER], axis=1)


@dataclass(frozen=True)
class RealPresses:
    """All marked presses, and where the rules without a network see them, (n, 2) mm."""

    frames: LabelledFrames

    @cached_property
    def clip(self) -> np.ndarray:
        """The clip of each press (n,)."""
        return self.frames.columns["clip"].astype(str)

    @cached_property
    def windows(self) -> LabelledFrames:
        """What networks see of them."""
        return windows_of(self.frames)

    @cached_property
    def center_of_change_mm(self) -> np.ndarray:
        """Centroids of the change."""
        return self._seen(lambda picture, rest: center_of_change_px(picture.astype(np.int16) - rest))

    @cached_property
    def level_point_mm(self) -> np.ndarray:
        """Where the change vanishes."""
        return self._seen(lambda picture, rest: level_point_px(picture, rest, _LEVEL_RADIUS_PX))

    def _seen(self, rule: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> np.ndarray:
        references = self.frames.references_at()
        pairs = ((self.frames.picture(k), references[r]) for k, r in enumerate(self.frames.reference_id))
        found_px = np.array([rule(picture, reference) for picture, reference in pairs])
        height, width = references.shape[1:3]
        return (found_px - np.array([width - 1, height - 1]) / 2) * MM_PER_PX

    def halves(self, draw: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the presses that a draw may learn from, and those that it is tested on."""
        clips = np.random.default_rng(draw // 2).permutation(np.unique(self.clip))
        tested = np.isin(self.clip, clips[draw % 2 :: 2])
        return np.flatnonzero(~tested), np.flatnonzero(tested)

    def labelled(self, draw: int, count: int) -> np.ndarray:
        """Return the presses whose marks a draw may learn from."""
        pool, _ = self.halves(draw)
        return np.random.default_rng([draw, count]).choice(pool, min(count, len(pool)), replace=False)


RULES: dict[str, tuple[tuple[int, ...], Callable[[RealPresses], np.ndarray]]] = {
    "constant mean": (FEW, lambda presses: np.empty((len(presses.frames), 0))),
    "centroid of the change": (NO_LABELS, lambda presses: presses.center_of_change_mm),
    "centroid, linear regression": (FEW, lambda presses: presses.center_of_change_mm),
    "point of no change": (NO_LABELS, lambda presses: presses.level_point_mm),
    "point of no change, linear regression": (FEW, lambda presses: presses.level_point_mm),
}
"""Methods without a network: numbers of labels, and what a rule sees; marks are regressed on that, linearly."""


def ruled_points(presses: RealPresses, rule: str, draw: int, labels: int) -> np.ndarray:
    """Return where a rule says that the tested presses of a draw are, (n, 2) mm."""
    _, tested = presses.halves(draw)
    seen_mm = RULES[rule][1](presses)
    if not labels:
        return seen_mm[tested]
    few, columns = presses.labelled(draw, labels), np.column_stack([np.ones(len(seen_mm)), seen_mm])
    return columns[tested] @ np.linalg.lstsq(columns[few], presses.frames.label_values[few], rcond=None)[0]


def point_profile(preset: str, epochs: int) -> Profile:
    """Return a preset for contact points: shifted pictures would have other labels, and dots are to be seen."""
    return Profile.preset(preset).replace(
        name=f"{preset}-contact-point",
        image_size_px=(WINDOW_PX, WINDOW_PX),
        shift_px=0,
        marker_hiding=0.0,
        colour_mixing=0.0,
        source_epochs=epochs,
    )


@dataclass(frozen=True)
class Plan:
    """How much is done: the profile, and the numbers of domains, frames, gels × balls, lights, draws and labels."""

    profile: Profile
    domains: int
    frames: int
    presses: int
    lights: tuple[str, ...]
    draws: range
    few: tuple[int, ...]
    steps_from_scratch: int

    def settings(self) -> list[Setting]:
        """Return all trials: a method with a number of labelled presses and a draw."""
        counts = {rule: own for rule, (own, _) in RULES.items()}
        for light in self.lights:
            counts |= {f"{light}{_LIGHT}{way}": NO_LABELS for way in (AS_TRAINED, STATISTICS)}
            counts |= {f"{light}{_LIGHT}{way}": FEW for way in (CORRECTED, TUNED)}
        return [
            {"method": method, "labels": labels, "draw": draw}
            for draw in self.draws
            for method, own in {**counts, SCRATCH: FEW}.items()
            for labels in own
            if labels in (*NO_LABELS, *self.few)
        ]


QUICK = Plan(point_profile("smoke", 2), 2, 8, 1, (DRAWN,), range(2), FEW[:1], 20)
WHOLE = Plan(point_profile("cpu", 20), 24, 64, 8, (DRAWN, CALIBRATED), range(4), FEW, 300)


class Trials:
    """The trials of a plan; `folder` keeps what is finished."""

    def __init__(self, plan: Plan, presses: RealPresses, folder: Path):
        self._plan, self._presses, self._folder = plan, presses, folder
        self._models: dict[tuple[str, int], ForceModel] = {}

    def records(self) -> pd.DataFrame:
        """Do the trials that have no record yet, and return the records of all."""
        plan = self._plan
        synthetic = [recipe.key for recipe in press_recipes(plan.domains, plan.frames, plan.presses)]
        marks = self._presses.frames.label_values.tolist()
        configuration = configuration_of(plan.profile, synthetic, plan.steps_from_scratch, marks)
        return run_missing(
            self.measure,
            plan.settings(),
            self._folder / "points.jsonl",
            workers=1,
            fixed=lambda setting: {"configuration": configuration},
            describe=lambda record: f"{np.mean(list(record['clip_mm'].values())):.3f} mm",
        )

    def measure(self, trial: Setting) -> Results:
        """Do one trial; the time is that of learning from labels and of predicting."""
        method, labels, draw = trial["method"], trial["labels"], trial["draw"]
        if method in RULES:
            start = time.perf_counter()
            points_mm = ruled_points(self._presses, method, draw, labels)
        else:
            windows = self._presses.windows.take(self._presses.halves(draw)[1])
            learn = self._way_to_learn(method, labels, draw)
            start = time.perf_counter()
            points_mm = centers_of(windows) + learn().predict(windows)
        return results_of(self._presses, draw, points_mm, time.perf_counter() - start)

    def _way_to_learn(self, method: str, count: int, draw: int) -> Callable[[], ForceModel]:
        """Return what learns from labels; what draws share is trained before."""
        # Windows without the contact point teach nothing.
        labelled = with_point(self._presses.windows.take(self._presses.labelled(draw, count)))
        profile = self._plan.profile
        if method == SCRATCH:
            epochs = self._plan.steps_from_scratch // max(1, len(labelled) // profile.batch_size)
            return lambda: train_source(labelled, profile.replace(source_epochs=epochs), draw)
        light, _, way = method.partition(_LIGHT)
        model, pool = self._model(light, draw // 2), self._presses.halves(draw)[0]
        return {
            AS_TRAINED: lambda: model,
            STATISTICS: lambda: with_statistics_of(model, self._presses.windows.take(pool)),
            CORRECTED: lambda: affine_correction(model, labelled),
            TUNED: lambda: fine_tune(model, labelled),
        }[way]

    def _model(self, light: str, seed: int) -> ForceModel:
        """Return the network that learnt on synthetic presses, generated and trained once."""
        if (light, seed) not in self._models:
            plan, folder, fitted = self._plan, self._folder / light, None
            if light == CALIBRATED:
                fitted = fitted_sensor(self._presses.frames, self._folder / "ball-sensor.toml")
            recipes = press_recipes(plan.domains, plan.frames, plan.presses, fitted)
            generate_recipes(recipes, folder, scheduler="synchronous")
            frames = contact_points([folder / recipe.name for recipe in recipes])
            pressed = frames.take(np.flatnonzero(frames.columns["depth_mm"] > 0))
            windows = with_point(windows_of(pressed, _COPIES, _JITTER_MM))
            self._models[light, seed] = Stage1(windows, plan.profile, seed, out=folder).model()[0]
        return self._models[light, seed]


def results_of(presses: RealPresses, draw: int, predicted_mm: np.ndarray, seconds: float) -> Results:
    """Return the mean distance of points (tested presses, 2) from the marks on each clip, mm.

    As it is and without the mean error, `offset_mm` (x, y).
    """
    _, tested = presses.halves(draw)
    error_mm = predicted_mm - presses.frames.label_values[tested]
    offset_mm = error_mm.mean(axis=0)
    return {
        "clip_mm": clip_means(np.hypot(*error_mm.T), presses.clip[tested]),
        "clip_centered_mm": clip_means(np.hypot(*(error_mm - offset_mm).T), presses.clip[tested]),
        "offset_mm": np.round(offset_mm, 5).tolist(),
        "seconds": round(seconds, 2),
    }


def run(quick: bool, out_dir: Path, data: Path) -> None:
    """Do the trials that have no record yet, print the table, and write `real-contact-point.json` to `out_dir`."""
    plan = QUICK if quick else WHOLE
    folder = out_dir / "real" / "contact-point" / plan.profile.name
    converted = converted_clone("ball-presses", data, out_dir)
    presses = RealPresses(contact_points([converted / "ball-presses"]))
    table = point_table(Trials(plan, presses, folder).records(), presses)
    table.show()
    write_json(out_dir / "real-contact-point.json", table)


def point_table(records: pd.DataFrame, presses: RealPresses) -> ResultTable:
    """Show each method with each number of labels."""
    ordered, rows = records.sort_values("labels", kind="stable").assign(pair=records["draw"] // 2), []
    for (labels, method), own in ordered.groupby(["labels", "method"], sort=False):
        away_mm, centered_mm = (
            clip_table(own, name, "pair").to_numpy() for name in ("clip_mm", "clip_centered_mm")
        )
        offset_mm = np.mean(own["offset_mm"].tolist(), axis=0)
        rows.append(
            {
                "method": method,
                "labels": labels,
                "mean, mm": float(mean_of(away_mm)),
                "95 % interval": bootstrap(away_mm),
                "centred, mm": float(mean_of(centered_mm)),
                "mean error (x, y), mm": "{:+.2f}, {:+.2f}".format(*offset_mm),
                "time, s": own["seconds"].median(),
            }
        )
    return result_table(
        "Contact point of real ball presses: distance from the mark on clips that were not learnt from",
        pd.DataFrame(rows),
        f"{len(presses.frames)} presses in {len(np.unique(presses.clip))} clips of at most twenty; "
        f"{records['draw'].nunique()} draws by clip, half of the clips tested in each; marks are whole pixels of "
        "0.1 mm. Labels: marked presses of the other half; networks with `statistics` see that half's pictures alone. "
        "Intervals: bootstrap over clips and draws. Centred: without the mean of the errors over the tested presses, "
        "which takes labels to know. Time: median, without the training that draws share.",
        {**dict.fromkeys(("mean, mm", "95 % interval", "centred, mm"), "{:.3f}"), "time, s": "{:.1f}"},
    )
