"""The benchmark of disturbed pictures, on a small set that gelgap itself rendered."""

from dataclasses import replace

import numpy as np
import pytest

from gelgap.benchmarks.render.disturbances import SPOILT, Disturbance, one_spoilt
from gelgap.benchmarks.render.scenes import sphere_dent
from gelgap.benchmarks.render.sensor_robustness import Trial, synthetic_set
from gelgap.render import PressProfiles, SolvedPress

RADIUS_MM, SIZE_PX = 2.0, (160, 120)


@pytest.fixture(scope="module")
def trial() -> Trial:
    solves = []
    for depth in (0.3, 0.6, 0.9, 1.2):
        x, y, displacement = sphere_dent(depth, half_extent_mm=(10.5, 8.2), radius_mm=RADIUS_MM)
        along = displacement[len(y) // 2, len(x) // 2 :, 2]
        solves.append(SolvedPress(depth, x[len(x) // 2 :], along, min((depth * RADIUS_MM) ** 0.5, 1.8)))
    profiles = {2 * RADIUS_MM: PressProfiles.from_solves(RADIUS_MM, solves)}
    return Trial.of(synthetic_set(profiles, SIZE_PX, 20), profiles)


def test_dots_are_drawn_and_predicted(trial: Trial) -> None:
    without, dotted = trial.dotted()
    for result in (without, dotted):
        assert (np.median(result["scores"], axis=0) > 30).all()
    assert dotted["undisturbed"].shape == (len(trial.predicted), 2)


def test_presses_that_are_refused_are_reported(trial: Trial) -> None:
    untouched = one_spoilt(lambda press, _: replace(press, picture=trial.found.reference))
    row = trial.row(Disturbance("untouched", fitted=untouched, outlier=True))
    assert row["note"].startswith(f"refused: {trial.fitted[SPOILT].name} hardly differs")
    assert row["scores"].shape == (0, 2)
