"""`gelgap benchmark render --quick` runs, and finds pictures close to the stored path-traced ones."""

from pathlib import Path

import numpy as np
import pytest

from gelgap.benchmarks.common import read_records
from gelgap.benchmarks.render import accuracy
from gelgap.benchmarks.render.scenes import STORED_SCENES, drawn_scene, stored_reference
from gelgap.cli.main import main
from gelgap.render import MembraneRenderer


def test_every_stored_scene_has_its_picture() -> None:
    for scene in STORED_SCENES:
        assert stored_reference(scene).shape == (96, 128, 3)


def test_the_quick_benchmark_runs_and_standard_quality_is_accurate(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    median_ms = accuracy.median_ms
    monkeypatch.setattr(accuracy, "median_ms", lambda work, repeats: median_ms(work, 1))
    monkeypatch.setattr(accuracy, "SIZES_PX", accuracy.SIZES_PX[:1])
    main(["benchmark", "render", "--quick", "--out", str(tmp_path)])
    errors, times, summary = accuracy.tables(read_records(tmp_path / "render.jsonl"))
    found = errors.frame
    assert set(found["scene"]) == {scene.name for scene in STORED_SCENES}
    standard = found[found["way"] == "standard"]
    assert len(standard) == len(STORED_SCENES)
    assert (standard["PSNR dB"].astype(float) > 44).all()
    assert (standard["mean error %"].astype(float) < 2).all()
    of_way = {row[0]: float(row[2]) for row in summary.cells}
    assert of_way["standard"] > of_way["no shadows"]
    assert ("320×240", "standard", "i0") in {tuple(row[:3]) for row in times.cells}


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_no_pixel_of_a_drawn_scene_is_far_from_the_finest_sampling(seed: int) -> None:
    scene = drawn_scene(seed)
    standard, fine = (
        MembraneRenderer(scene.sensor(), scene.light(), (160, 120), quality).linear(
            *scene.membrane(), markers=False
        )
        for quality in ("standard", "fine")
    )
    assert np.minimum(standard, fine).min() >= 0
    assert np.abs(standard - fine).max() < 0.08
