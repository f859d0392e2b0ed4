"""Markers are found in the picture alone, and filled in close to the truly unmarked rendering."""

import numpy as np
import pytest

from gelgap.data.inpainting import detect_markers, inpaint_telea
from gelgap.render.imaging import psnr_db
from gelgap.render.light.leds import Illumination
from gelgap.render.renderer import MembraneRenderer
from gelgap.render.sensor import Markers, Sensor


@pytest.mark.parametrize("illumination", ["i0", "i1", "i2"])
def test_found_markers_are_the_painted_ones(renderer, dent, illumination):
    case = dent(0.8, (0.3, 0.1))
    render = renderer(illumination)
    noise = (np.random.default_rng(seed) for seed in (1, 2))
    marked, plain = (
        render.picture(*case, markers=flag, rng=rng) for flag, rng in zip((True, False), noise, strict=True)
    )
    clean = [render.picture(*case, markers=flag).astype(int) for flag in (True, False)]
    painted = np.abs(clean[0] - clean[1]).max(axis=2) > 4
    mask = detect_markers(marked)
    assert (painted & ~mask).mean() < 0.002
    assert mask.mean() < painted.mean() + 0.05
    assert detect_markers(plain).mean() == 0


def test_inpainting_comes_close_to_the_unmarked_picture(renderer, dent):
    case = dent(0.6, (0.2, 0.0))
    marked, plain = (renderer().picture(*case, markers=flag) for flag in (True, False))
    mask = detect_markers(marked)
    telea = inpaint_telea(marked, mask)
    assert np.array_equal(telea[~mask], marked[~mask])
    assert psnr_db(telea, plain) > 45


@pytest.mark.parametrize(
    "markers",
    [
        Markers(shape="square"),
        Markers(pitch_mm=(1.0, 1.6), rows=5, offset_mm=(0.2, 0.1)),
        Markers(positions_mm=((0.1, 0.2), (2.13, -1.52), (-3.25, 1.04), (4.4, 3.2), (-4.1, -2.7))),
    ],
)
def test_other_markers_are_filled_in_as_well(dent, markers):
    sensor = Sensor.preset("paper").model_copy(update={"markers": markers})
    render = MembraneRenderer(sensor, Illumination.preset("i0"))
    marked, plain = (render.picture(*dent(0.6, (0.2, 0.0)), markers=flag) for flag in (True, False))
    assert psnr_db(inpaint_telea(marked, detect_markers(marked)), plain) > 45


def test_a_mask_at_the_edges_is_filled_from_inside():
    picture = np.full((24, 32, 3), (40, 90, 160), np.uint8)
    mask = np.zeros((24, 32), bool)
    mask[:5, :6] = mask[-1, 10:20] = mask[8:12, -3:] = True
    marked = np.where(mask[..., None], np.uint8(0), picture)
    assert np.abs(inpaint_telea(marked, mask).astype(int) - picture).max() <= 3
    assert np.array_equal(inpaint_telea(picture, np.ones((24, 32), bool)), picture)


def test_bad_pictures_are_refused():
    with pytest.raises(ValueError, match="uint8"):
        detect_markers(np.zeros((24, 32, 3)))
    with pytest.raises(ValueError, match="mask has shape"):
        inpaint_telea(np.zeros((24, 32, 3), np.uint8), np.zeros((8, 8), bool))


def test_psnr_of_a_mask():
    picture = np.zeros((4, 4, 3), np.uint8)
    expected = picture + np.uint8(10)
    expected[:2] = 0
    assert psnr_db(picture, expected, np.arange(4)[:, None].repeat(4, 1) >= 2) == pytest.approx(
        28.13, abs=0.01
    )
    assert psnr_db(picture, expected) == pytest.approx(28.13 + 10 * np.log10(2), abs=0.01)
    assert psnr_db(picture / 255, expected / 255, peak=1.0) == pytest.approx(psnr_db(picture, expected))
    assert psnr_db(picture, picture) > 100
