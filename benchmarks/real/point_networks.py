"""Networks that learn the contact point on synthetic presses, then from no or a few marks of real ones."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelgap.adapt import (
    ForceModel,
    Profile,
    Stage1,
    affine_correction,
    fine_tune,
    train_source,
    with_statistics_of,
)
from gelgap.benchmarks.real.point_trials import FEW, NO_LABELS, RealPresses
from gelgap.benchmarks.real.press_windows import WINDOW_PX, training_windows
from gelgap.domains import LabelledFrames

SCRATCH = "network from scratch"
AS_TRAINED, STATISTICS, CORRECTED, TUNED = ("as trained", "statistics", "affine correction", "fine-tuned")


@dataclass(frozen=True)
class Predicted:
    """What a network said of the tested presses (n, 2) in mm, with how many labels, and the time it took, s."""

    method: str
    labels: int
    points_mm: np.ndarray
    seconds: float


def point_profile(preset: str, epochs: int | None = None) -> Profile:
    """Return a preset for contact points: shifted pictures would have other labels, and dots are to be seen."""
    profile = Profile.preset(preset)
    return profile.replace(
        name=f"{preset}-contact-point",
        image_size_px=(WINDOW_PX, WINDOW_PX),
        shift_px=0,
        marker_hiding=0.0,
        colour_mixing=0.0,
        source_epochs=epochs or profile.source_epochs,
    )


def network_name(light: str, what: str) -> str:
    """Return the name of a method in the tables."""
    return f"{light} light, {what}"


def methods_of(light: str, few: tuple[int, ...]) -> list[tuple[str, int]]:
    """Return the methods with their numbers of labels that `transferred` yields."""
    without = [(network_name(light, what), NO_LABELS) for what in (AS_TRAINED, STATISTICS)]
    return without + [(network_name(light, what), count) for count in few for what in (CORRECTED, TUNED)]


def trained(synthetic: LabelledFrames, profile: Profile, seed: int, out: Path) -> ForceModel:
    """Return the network of stage 1, trained once."""
    return Stage1(training_windows(synthetic), profile, seed, out=out).model()[0]


def transferred(
    light: str, model: ForceModel, presses: RealPresses, draw: int, few: tuple[int, ...] = FEW
) -> Iterator[Predicted]:
    """Yield what a trained network predicts without labels, with the pool's statistics, and with a few labels."""
    pool, tested = presses.halves(draw)
    yield _predicted(network_name(light, AS_TRAINED), NO_LABELS, presses, tested, lambda: model)
    yield _predicted(
        network_name(light, STATISTICS),
        NO_LABELS,
        presses,
        tested,
        lambda: with_statistics_of(model, presses.windows.frames.take(pool)),
    )
    for count in few:
        labelled = _labelled(presses, draw, count)
        for name, learn in ((CORRECTED, affine_correction), (TUNED, fine_tune)):
            yield _predicted(
                network_name(light, name), count, presses, tested, lambda a=learn, b=labelled: a(model, b)
            )


def from_scratch(
    presses: RealPresses, profile: Profile, draw: int, count: int, steps: int
) -> Iterator[Predicted]:
    """Yield what a network predicts that has only seen a few marked presses."""
    labelled = _labelled(presses, draw, count)
    epochs = steps // max(1, len(labelled) // profile.batch_size)
    yield _predicted(
        SCRATCH,
        count,
        presses,
        presses.halves(draw)[1],
        lambda: train_source(labelled, profile.replace(source_epochs=epochs), draw),
    )


def _labelled(presses: RealPresses, draw: int, count: int) -> LabelledFrames:
    """Return the windows of a draw's labelled presses; those without the contact point teach nothing."""
    windows = presses.windows.take(presses.labelled(draw, count))
    return windows.frames.take(np.flatnonzero(windows.has_point))


def _predicted(
    method: str, labels: int, presses: RealPresses, rows: np.ndarray, learn: Callable[[], ForceModel]
) -> Predicted:
    """Return the points that a model predicts, with the time that it took to learn and to predict."""
    windows = presses.windows.take(rows)
    start = time.perf_counter()
    points_mm = windows.centers_mm + learn().predict(windows.frames)
    return Predicted(method, labels, points_mm, time.perf_counter() - start)
