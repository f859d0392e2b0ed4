"""The benchmark of disturbed pictures, on a small set that gelgap itself rendered."""

import numpy as np
import pytest

from gelgap.benchmarks.render.robustness import DISTURBANCES, SPOILT, Trial, one_spoilt, synthetic_set
from gelgap.benchmarks.render.scenes import sphere_dent
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
    return Trial(synthetic_set(profiles, SIZE_PX, 14), profiles)


@pytest.mark.parametrize(
    "name", ["dots, predicted with", pytest.param("dots, predicted without", marks=pytest.mark.slow)]
)
def test_dots_are_drawn_and_predicted(trial: Trial, name: str) -> None:
    result = trial.measure({"disturbance": name})
    assert all(np.median(levels) > 34 for levels in result["own"].values())
    assert [len(levels) for levels in result["undisturbed"].values()] == [len(trial.predicted)] * 2


def test_presses_that_are_refused_are_reported(trial: Trial, monkeypatch: pytest.MonkeyPatch) -> None:
    untouched = one_spoilt(lambda press, other: {"picture": trial.found.reference})
    monkeypatch.setitem(DISTURBANCES, "untouched", untouched)
    result = trial.measure({"disturbance": "untouched"})
    assert result["note"].startswith(f"refused: {trial.fitted[SPOILT].name} hardly differs")
    assert result["own"] == {"inside": [], "ring": []}


@pytest.mark.slow
def test_a_view_can_be_cut_at_presses(trial: Trial) -> None:
    result = trial.measure({"disturbance": "view cut at the presses"})
    assert "fitted presses on the edge" in result["note"]
    assert np.median(result["own"]["inside"]) > 25
