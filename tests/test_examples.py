"""Every example runs."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from loaded_file import load_file
from quick_solves import coarsen, shrink_libraries

from gelgap.data import open_domain
from gelgap.sim import ContactPath, PoseRanges

pytestmark = pytest.mark.usefixtures("coarse")
EXAMPLES = Path(__file__).parents[1] / "examples"


def load(name: str) -> ModuleType:
    return load_file(EXAMPLES / f"{name}.py")


@pytest.fixture(scope="module")
def own_gap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out_dir = tmp_path_factory.mktemp("own_gap")
    path = ContactPath(
        name="tiny",
        points_x_mm=(-1.0, 1.0),
        points_y_mm=(0.0,),
        depths_mm=(0.4,),
        radii_mm=(0.2,),
        angles_deg=(0.0, 60.0, 120.0, 180.0, 240.0, 300.0),
    )
    with pytest.MonkeyPatch.context() as patch:
        coarsen(patch)
        load("own_gap").main(out_dir, path, "draft", size_px=(64, 48))
    return out_dir


def test_own_gap_makes_two_domains_that_differ_in_force_and_light(own_gap: Path) -> None:
    source, target = open_domain(own_gap / "wmb0i0"), open_domain(own_gap / "harder-slippery-redder")
    assert len(source) == len(target) == 14
    assert target.force_n[:, 2].min() < source.force_n[:, 2].min()
    assert target.reference[..., 0].mean() > source.reference[..., 0].mean()
    assert (own_gap / "own_gap.png").stat().st_size > 1000


def test_own_method_trains(own_gap: Path, capsys: pytest.CaptureFixture[str]) -> None:
    load("own_method").main(own_gap / "wmb0i0", own_gap / "harder-slippery-redder")
    assert "MeanMatching" in capsys.readouterr().out


def test_own_backbone_trains(own_gap: Path, capsys: pytest.CaptureFixture[str]) -> None:
    load("own_backbone").main(own_gap / "wmb0i0", own_gap / "harder-slippery-redder")
    assert capsys.readouterr().out.startswith("make_backbone source-only  mean error on the target")


def test_another_modulus_is_found_by_loads(own_gap: Path, capsys: pytest.CaptureFixture[str]) -> None:
    load("another_modulus").main(own_gap / "wmb0i0", own_gap / "harder-slippery-redder", loads=2)
    assert capsys.readouterr().out.startswith("the gel is ")


def test_own_sensor_sees_the_contact_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    pixels = load("own_sensor").main(picture=tmp_path / "own.png", quality="draft")
    assert (tmp_path / "own.png").stat().st_size > 1000
    assert pixels.shape == (240, 320, 3)
    assert 20 < pixels.mean() < 235


def test_a_pi_law_holds_a_force(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("gymnasium")
    shrink_libraries(monkeypatch)
    share = load("hold_force").main(40, deepest_mm=0.3, farthest_mm=0.05, size_px=(48, 36))
    assert share[0] < 0.5
    assert np.abs(share[-5:] - 1).max() < 0.02


def test_any_light_trains(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    shrink_libraries(monkeypatch)
    example = load("any_light")
    monkeypatch.setattr(example, "RANGES", PoseRanges(0.1, 0.2, 0.05))
    monkeypatch.setattr(example, "PRESSES", ((0.2, 0.0, 0.0),))
    example.main(lights=1, contacts=1, steps=1)
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition(",")[0] for line in lines] == ["i0", "i1", "i2"]


def test_any_light_reads_slopes_by_presses_and_says_where_it_doubts_them() -> None:
    rng, to_colours = np.random.default_rng(0), np.array([[1.0, -0.5, 0.2], [0.1, 0.8, -0.9]])
    slopes = rng.uniform(-0.5, 0.5, (3, 48, 64, 2))
    table = load("any_light").slopes_by_colour(slopes[:2] @ to_colours, slopes[:2])
    doubt, *read = np.moveaxis(table(slopes[2] @ to_colours), -1, 0)
    np.testing.assert_allclose(np.stack(read, -1), slopes[2], atol=0.02)
    assert table(2 * slopes[2] @ to_colours)[..., 0].mean() > 2 * doubt.mean()


@pytest.mark.parametrize("turn", range(8))
def test_any_light_turns_slopes_places_and_forces_with_the_picture(turn: int) -> None:
    example = load("any_light")
    heights = np.random.default_rng(turn).normal(size=(2, 9, 9)).cumsum(1).cumsum(2)
    place = np.stack(np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)))
    vectors = np.array([example.ALONG_X, example.ALONG_Y]).T  # of slopes, of place
    inputs = np.zeros((2, example.CHANNELS, 9, 9))
    inputs[:, 0], inputs[:, vectors[1]] = heights, place
    inputs[:, example.SLOPES] = np.stack(np.gradient(heights, axis=(2, 1)), 1)
    # A force as the sum of slopes, which turns with them.
    turned, force_n = example.turned(inputs, np.c_[inputs[:, example.SLOPES].sum((2, 3)), [1.0, 2.0]], turn)
    np.testing.assert_allclose(turned[:, example.SLOPES], np.stack(np.gradient(turned[:, 0], axis=(2, 1)), 1))
    np.testing.assert_allclose(force_n, np.c_[turned[:, example.SLOPES].sum((2, 3)), [1.0, 2.0]])
    np.testing.assert_allclose(turned[:, vectors[1]], np.broadcast_to(place, (2, 2, 9, 9)), atol=1e-12)
