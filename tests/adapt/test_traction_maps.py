"""A dense head learns where the force is, and how much it is together."""

from types import SimpleNamespace

import numpy as np
import pytest

from gelgap.adapt import ForceModel, learn_traction_maps, traction_errors, traction_maps_n
from gelgap.adapt.traction_maps import cell_places
from gelgap.domains import ArrayFrames
from gelgap.render import Sensor

FRAMES = 96


@pytest.fixture(scope="module")
def domain() -> SimpleNamespace:
    """Bright squares of 6 × 6 cells, each cell of which carries a force by its brightness."""
    rng = np.random.default_rng(0)
    maps_n = np.zeros((FRAMES, 24, 32, 3))
    for own in maps_n[1:]:  # the first is untouched
        row, column = rng.integers(2, 17), rng.integers(2, 25)
        own[row : row + 6, column : column + 6] = rng.uniform(0.02, 0.05) * np.array([0.3, 0.0, -1.0])
    pictures = np.clip(90 - 3000 * maps_n[..., [2, 2, 0]], 0, 255).astype(np.uint8)
    pictures = pictures.repeat(2, axis=1).repeat(2, axis=2)
    force_n = maps_n.sum(axis=(1, 2))
    frames = ArrayFrames("squares", pictures, pictures[0], force_n, force_range_n=np.array([[-2.0, 2.0]] * 3))
    camera = Sensor.preset("paper").camera
    return SimpleNamespace(
        name="squares",
        size_px=(64, 48),
        take=frames.take,
        traction_map_n=lambda row: maps_n[row],
        recipe=SimpleNamespace(sensor=SimpleNamespace(camera=camera)),
        traction_half_extent_mm=tuple(side / 2 for side in camera.footprint_mm((64, 48))),
    )


def test_cells_are_sought_where_the_camera_sees_them(domain: SimpleNamespace) -> None:
    places = cell_places(domain, (24, 32))
    np.testing.assert_allclose(places[0, 0], (-31 / 32, -23 / 24), atol=1e-9)
    beyond = cell_places(SimpleNamespace(**{**vars(domain), "traction_half_extent_mm": (7.0, 5.5)}), (24, 32))
    np.testing.assert_allclose(beyond, places * (7 / 6, 5.5 / 4.5), atol=1e-9)  # the picture shows 12 × 9 mm


def test_maps_are_learnt_and_told_by_cell_and_by_sum(domain: SimpleNamespace, stage1: ForceModel) -> None:
    seen, unseen = np.arange(64), np.arange(64, FRAMES)
    said: list[str] = []
    maps = learn_traction_maps(stage1, domain, seen, epochs=200, progress=lambda *told: said.append(told[-1]))
    assert len(said) == 200
    assert float(said[-1].split()[-1]) < 0.6  # although no sum is along y
    true_n, mean_n = traction_maps_n(domain, unseen), traction_maps_n(domain, seen).mean(axis=0)
    predicted_n = maps.predict_n(domain.take(unseen))
    errors = traction_errors(predicted_n, true_n, mean_n)
    for name in ("z: a loaded cell, mN", "x: a loaded cell, mN"):
        assert errors.loc["predicted", name] < 0.7 * errors.loc["mean map", name]
    other = maps.with_statistics_of(domain.take(unseen))
    assert not np.array_equal(other.predict_n(domain.take(unseen)), predicted_n)


def test_the_same_maps_are_learnt_again(domain: SimpleNamespace, stage1: ForceModel) -> None:
    one, other = (
        learn_traction_maps(stage1, domain, np.arange(32), epochs=1).predict_n(domain.take(np.arange(4)))
        for _ in range(2)
    )
    np.testing.assert_array_equal(one, other)  # and the backbone that they began with has not moved


def test_errors_are_those_of_cells_and_of_their_sum() -> None:
    maps_n = np.zeros((2, 24, 32, 3))
    maps_n[:, 3, 4, 2] = -0.2
    predicted_n = maps_n.copy()
    predicted_n[:, 3, 5, 2] = -0.1  # beside the loaded cell
    errors = traction_errors(predicted_n, maps_n, np.zeros((24, 32, 3)))
    assert errors.loc["predicted", "z: a loaded cell, mN"] == 0
    assert errors.loc["mean map", "z: a loaded cell, mN"] == pytest.approx(200)
    assert errors.loc["predicted", "z: a cell, mN"] == pytest.approx(100 / 768)
    assert errors.loc["predicted", "z: the sum, N"] == pytest.approx(0.1)


def test_frames_without_load_are_refused(domain: SimpleNamespace, stage1: ForceModel) -> None:
    with pytest.raises(ValueError, match="none of 1 frames carries load"):
        learn_traction_maps(stage1, domain, [0])
