"""`gelgap benchmark render --quick` runs, and finds pictures close to the stored path-traced ones."""

import json
from pathlib import Path

from gelgap.benchmarks.render.accuracy import run
from gelgap.benchmarks.render.path_tracer import stored_reference
from gelgap.benchmarks.render.scenes import STORED_SCENES


def test_every_stored_scene_has_its_picture() -> None:
    for scene in STORED_SCENES:
        assert stored_reference(scene).shape == (96, 128, 3)


def test_the_quick_benchmark_runs_and_standard_quality_is_accurate(tmp_path: Path) -> None:
    run(quick=True, out_dir=tmp_path)
    results = json.loads((tmp_path / "render.json").read_text())
    assert set(results["errors"]) == {scene.name for scene in STORED_SCENES}
    for ways in results["errors"].values():
        assert ways["standard"]["psnr_db"] > 44
        assert ways["standard"]["mean"] < 0.02
    assert results["summary"]["standard"][1] > results["summary"]["no shadows"][1]
    assert {"surface", "raster", "light", "noise"} <= set(results["times_ms"]["320×240 standard i0"])
    assert (tmp_path / "render-contact-sheet.png").stat().st_size > 10_000
