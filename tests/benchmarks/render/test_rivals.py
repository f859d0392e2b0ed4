"""Tables without physics on pictures whose change is known; Taxim's renderer is played."""

import sys
from functools import partial
from types import ModuleType

import numpy as np
import pytest

from gelgap.benchmarks.render import rivals
from gelgap.domains import PressSet
from gelgap.domains.calibration_presses import MM_PER_PX, start_sensor
from gelgap.render import PressPicture

SIZE_PX, RADIUS_PX, DIAMETER_MM = (160, 120), 15.0, 1.2
REFERENCE = np.full((SIZE_PX[1], SIZE_PX[0], 3), 100, np.uint8)


def pressed(x, y, strength=1.0):
    """A press that turns red up to its left and blue up below it, and nothing beyond two radii."""
    rows, columns = np.indices(REFERENCE.shape[:2])
    left, below = (x - columns) / RADIUS_PX, (rows - y) / RADIUS_PX
    picture = REFERENCE.astype(float)
    near = np.hypot(left, below) < 2
    picture[..., 0] += np.where(near, 30 * strength * left, 0)
    picture[..., 2] += np.where(near, 30 * strength * below, 0)
    return PressPicture(
        np.round(picture).astype(np.uint8), DIAMETER_MM, radius_px=RADIUS_PX, center_px=(float(x), float(y))
    )


def pressed_set(strength=lambda x: 1.0, count=16):
    places = np.random.default_rng(0).integers((35, 35), (125, 85), (count, 2))
    presses = tuple(pressed(x, y, strength(x)) for x, y in places)
    return PressSet(REFERENCE, presses, start_sensor(SIZE_PX[0], np.zeros(3)))


def errors(model, found):
    """Errors of odd presses where the even ones are fitted."""
    draw, _ = model(range(0, 16, 2))
    return [np.abs(draw(k)().astype(float) - found.presses[k].picture).mean() for k in range(1, 16, 2)]


@pytest.mark.parametrize("degree", [0, 2])
def test_a_plain_table_predicts_what_depends_on_the_offset_alone(degree):
    found = pressed_set()
    predicted = errors(partial(rivals.plain_table, found, degree), found)
    assert max(predicted) < 0.2 * min(errors(partial(rivals.unchanged, found), found))


def test_only_the_quadratic_table_follows_a_change_that_grows_with_the_place():
    found = pressed_set(lambda x: x / 80)
    constant, quadratic = (
        np.mean(errors(partial(rivals.plain_table, found, degree), found)) for degree in (0, 2)
    )
    assert quadratic < 0.6 * constant


class PlayedTaxim:
    """Remembers what it rendered; its picture is black where the ball touches flat gel."""

    def __init__(self, folder, backend, device):
        assert (folder / "polycalib.npz").is_file()
        assert not np.load(folder / "gelmap.npy").any()
        self.sensor_params = type("Parameters", (), {"pixmm": MM_PER_PX})

    def render(self, height_mm, with_shadow):
        return np.repeat((height_mm > 0)[..., None] * 0.5, 3, axis=2)


@pytest.fixture
def played_taxim(tmp_path, monkeypatch):
    folder = tmp_path / "calib" / "gelsight"
    folder.mkdir(parents=True)
    np.savez(folder / "polycalib.npz", grad_r=np.zeros(1))
    np.save(folder / "gelmap.npy", np.ones(REFERENCE.shape[:2]))
    package = ModuleType("taxim")
    package.__file__, package.Taxim = str(tmp_path / "__init__.py"), PlayedTaxim
    monkeypatch.setitem(sys.modules, "taxim", package)
    return folder


def test_taxims_ball_touches_in_the_marked_circle_or_as_deep_as_gelgap_says(played_taxim):
    found = pressed_set()
    x, y = found.presses[9].center_px
    rows, columns = np.indices(REFERENCE.shape[:2])
    deep_px = (0.3 * (DIAMETER_MM - 0.3)) ** 0.5 / MM_PER_PX
    for depths_mm, radius_px in ((None, RADIUS_PX), (np.full(len(found.presses), 0.3), deep_px)):
        draw, fit_s = rivals.taxim(found, "gelsight", depths_mm, range(8))
        picture = draw(9)()
        assert (picture[0, 0, 0], fit_s) == (128, None)
        touched = picture[..., 0] == 0
        assert np.abs(np.sqrt(touched.sum() / np.pi) - radius_px) < 0.5
        assert np.hypot(columns[touched] - x, rows[touched] - y).max() < radius_px + 0.01
    assert np.load(played_taxim / "gelmap.npy").all()
