"""`gelgap benchmark render --quick` runs, and finds pictures close to the stored path-traced ones."""

import json
from pathlib import Path

import numpy as np
import pytest

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
    results = json.loads((tmp_path / "render.json").read_text())
    assert {row["scene"] for row in results["errors"]} == {scene.name for scene in STORED_SCENES}
    standard = [row for row in results["errors"] if row["way"] == "standard"]
    assert len(standard) == len(STORED_SCENES)
    for row in standard:
        assert row["PSNR dB"] > 44
        assert row["mean error %"] < 2
    worst = {row["way"]: row["PSNR dB median"] for row in results["summary"]}
    assert worst["standard"] > worst["no shadows"]
    times = {row.pop("ms per frame"): row for row in results["times"]}
    assert set(times["320×240 standard i0"]) == {"typical", "worst", "with noise"}


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
