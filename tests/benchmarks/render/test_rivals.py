"""Tables without physics and Taxim's table on pictures whose change is known; Taxim's renderer is played."""

import sys
from functools import partial
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from gelgap.benchmarks.render import rivals
from gelgap.benchmarks.render.rivals import BINS, fit_table
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


def test_taxims_table_holds_the_change_by_the_balls_normal():
    table = fit_table(REFERENCE, pressed_set().presses, MM_PER_PX)
    assert table.shape == (BINS, BINS, 6, 3)
    place = np.array([80.0**2, 60.0**2, 80.0 * 60.0, 80.0, 60.0, 1.0])
    ball_px = DIAMETER_MM / 2 / MM_PER_PX
    for offset_px, channel in (((-10, 0), 0), ((0, 10), 2)):
        inclination = np.arcsin(10 / ball_px) / (np.pi / 2 / (BINS - 1))
        direction = (np.arctan2(-offset_px[1], -offset_px[0]) + np.pi) / (2 * np.pi / (BINS - 1))
        change = place @ table[int(inclination), int(direction)]
        assert change[channel] == pytest.approx(20, abs=2.5)
        assert change[1] == pytest.approx(0, abs=0.1)


class PlayedTaxim:
    """Remembers what it was calibrated with and what it rendered; its picture is black where the ball touches."""

    def __init__(self, folder, backend, device):
        with np.load(folder / "polycalib.npz") as file:
            self.table = {name: file[name] for name in file.files}
        self.gel = np.load(folder / "gelmap.npy")
        self.sensor_params = type("Parameters", (), {"pixmm": MM_PER_PX})
        self.heights = []
        PlayedTaxim.last = self

    def render(self, height_mm, with_shadow):
        self.heights.append(height_mm)
        gel = (self.gel - self.gel.max()) * MM_PER_PX
        return np.repeat((height_mm > gel)[..., None] * 0.5, 3, axis=2)


@pytest.fixture
def played_taxim(tmp_path, monkeypatch):
    folder = tmp_path / "calib" / "gelsight"
    folder.mkdir(parents=True)
    np.savez(folder / "polycalib.npz", grad_r=np.zeros(1))
    rows, columns = np.indices(REFERENCE.shape[:2])
    np.save(folder / "gelmap.npy", 140 - 0.001 * ((columns - 80.0) ** 2 + (rows - 60.0) ** 2))
    package = ModuleType("taxim")
    package.__file__, package.Taxim = str(tmp_path / "__init__.py"), PlayedTaxim
    monkeypatch.setitem(sys.modules, "taxim", package)
    return folder


def test_taxims_ball_touches_in_the_marked_circle_of_a_flat_gel(played_taxim):
    found = pressed_set()
    before = Path(played_taxim / "polycalib.npz").read_bytes()
    depths = np.full(len(found.presses), 0.5)
    draw, _ = rivals.taxim(found, "gelsight", depths, rivals.TAXIM_FORMS[rivals.REFITTED], range(8))
    x, y = found.presses[9].center_px
    rows, columns = np.indices(REFERENCE.shape[:2])
    touched = draw(9)()[..., 0] == 0
    assert np.abs(np.sqrt(touched.sum() / np.pi) - RADIUS_PX) < 0.5
    assert np.hypot(columns[touched] - x, rows[touched] - y).max() < RADIUS_PX + 0.01
    own = PlayedTaxim.last
    table = fit_table(REFERENCE, found.presses[:8], MM_PER_PX)
    np.testing.assert_allclose(own.table["grad_b"], table[..., 0])  # what the package calls blue is red
    np.testing.assert_allclose(own.table["grad_r"], table[..., 2])
    assert not own.gel.any()
    assert Path(played_taxim / "polycalib.npz").read_bytes() == before


@pytest.mark.parametrize("form", rivals.TAXIM_FORMS.values(), ids=rivals.TAXIM_FORMS)
def test_taxims_forms_differ_in_table_gel_depth_and_background(played_taxim, form):
    found = pressed_set()
    depths = np.full(len(found.presses), 0.3)
    draw, fit_s = rivals.taxim(found, "gelsight", depths, form, range(8))
    picture = draw(9)()
    own = PlayedTaxim.last
    assert (own.table["grad_r"].ndim == 4 - 1) == form.refitted
    assert (fit_s is None) != form.refitted
    assert own.gel.any() == form.domed
    x, y = (int(at) for at in found.presses[9].center_px)
    gel_mm = (own.gel - own.gel.max()) * MM_PER_PX
    cap_mm = DIAMETER_MM / 2 - np.sqrt((DIAMETER_MM / 2) ** 2 - (RADIUS_PX * MM_PER_PX) ** 2)
    depth = 0.3 if form.deep else cap_mm
    assert own.heights[-1][y, x] == pytest.approx(gel_mm[y, x] - depth, abs=1e-3)
    assert picture[0, 0, 0] == (100 if form.on_reference else 128)
