"""The benchmark's other parts: designs of gap curves, factorial effects, ablation, costs, and the report of all."""

from pathlib import Path

import numpy as np
import pytest

from gelgap.adapt import adapt_frames
from gelgap.benchmarks.adaptation import gaps, labels, speed
from gelgap.benchmarks.adaptation.figures import prediction_figures
from gelgap.benchmarks.adaptation.gaps import CrossedCell, Gap, GapResults, design, effects
from gelgap.benchmarks.adaptation.jobs import AT_RANDOM, BY_POINT, RUNS, RunRecord, TrainingJob
from gelgap.benchmarks.adaptation.paper import GROUPS
from gelgap.benchmarks.adaptation.parts import write_benchmark_report
from gelgap.benchmarks.adaptation.results import GroupOracles, is_benchmark, write_oracles
from gelgap.benchmarks.common.records import append_record
from gelgap.benchmarks.common.tables import write_json


def test_gap_design_changes_one_thing_at_a_time():
    from gelgap.domains import differing_fields

    found = design()
    recipes = {recipe.name: recipe for recipe in found.recipes}
    base = recipes["mb0i0"]
    changed = {
        name: {
            field.split(".")[0] for field in differing_fields(base.configuration(), recipe.configuration())
        }
        for name, recipe in recipes.items()
    }
    assert changed["friction-001"] == {"name", "elastomer"}
    assert changed["noise-002"] == changed["markers-001"] == {"name", "sensor"}
    assert changed["crossed-111"] == {"name", "elastomer", "illumination", "markers"}
    sizes = {(gap.panel, gap.domain): gap.size for gap in found.gaps}
    assert sizes["modulus", "modulus-001"] == 0.5
    assert sizes["markers", "no-markers-001"] == 100
    assert sizes["light", "mb0i1"] > sizes["light", "light-001"] > 5
    assert len({(c.modulus, c.light, c.markers) for c in found.cells}) == 8
    # Cells that a curve has already are taken from there: the base, the modulus, the light and the missing markers.
    assert sum(c.domain.startswith("crossed") for c in found.cells) == 4


def crossed(error) -> GapResults:
    cells = tuple(
        CrossedCell(f"{m:d}{i:d}{k:d}", m, i, k)
        for m in (False, True)
        for i in (False, True)
        for k in (False, True)
    )
    errors = {c.domain: {"dsan": error(c), "constant mean": 0.4} for c in cells}
    gaps = (Gap("modulus", "000", 1.0), Gap("modulus", "100", 0.7))
    return GapResults(("dsan",), 1, gaps, cells, errors, dict.fromkeys(errors, 0.05))


def test_effects_are_those_of_the_factorial_design():
    found = effects(
        crossed(lambda c: 0.1 + 0.2 * c.modulus + 0.05 * c.light - 0.04 * c.light * c.markers), "dsan"
    )
    assert found["mean"] == pytest.approx(0.1 + 0.1 + 0.025 - 0.01)
    assert found["modulus"] == pytest.approx(0.2)
    assert found["light"] == pytest.approx(0.05 - 0.02)
    assert found["light × markers"] == pytest.approx(-0.02)
    assert found["modulus × light × markers"] == pytest.approx(0)


def test_report_of_all_parts(tmp_path):
    folder = tmp_path / "cpu"
    rng = np.random.default_rng(0)
    assert not is_benchmark(folder)
    for group in GROUPS:
        for method in ("source-only", "dann", "dsan", "supervised"):
            for seed in (0, 1):
                mae = tuple((0.1 + 0.1 * rng.random(3)).tolist())
                job = TrainingJob(*group, method, seed, changes=BY_POINT)
                line = RunRecord(
                    job, "cpu", mae_n=mae, r2=(0.9,) * 3, constant_mean_n=(0.4,) * 3, stage2_s=3.0
                )
                append_record(folder / RUNS, line)
    write_oracles(folder, {group: GroupOracles((0.01,) * 3, (0.02,) * 3) for group in GROUPS})
    append_record(folder / labels.RECORD, label_record(GROUPS[0], "dsan", {0: 0.2, 1: 0.1}))
    write_json(folder / gaps.RESULTS, crossed(lambda c: 0.1))
    loops = [speed.Speed(name, 40.0, 0.01, 0.02) for name in ("stage 1", "stage 2, supervised")]
    write_json(folder / speed.RESULTS, loops)
    page = write_benchmark_report(folder, tmp_path / "out").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 5
    text = Path(tmp_path / "out" / "adaptation.md").read_text(encoding="utf-8")
    for expected in (
        "Nemenyi's difference",
        "A few labelled target frames",
        "Effects and interactions",
        "![Mean ranks",
        "pose oracle",
        "25.0 | +2.0 %",
    ):
        assert expected in text
    latex = Path(tmp_path / "out" / "adaptation.tex").read_text(encoding="utf-8")
    assert not set("→±×≥…²λ") & set("".join(ln for ln in latex.splitlines() if not ln.startswith("%")))


def test_figures_show_the_kept_runs_of_the_shown_methods(source, target, profile, tmp_path):
    short = profile.replace(source_epochs=1, adapt_epochs=1)
    assert prediction_figures(tmp_path) == []
    adapt_frames(target, source, ["source-only", "dsan-coarse"], short, out_dir=tmp_path)
    scatter, _ = prediction_figures(tmp_path)
    assert [axes.get_title().partition(":")[0] for axes in scatter.figure.axes] == ["source-only"] * 3


def label_record(
    group: tuple[str, str], method: str, errors: dict[int, float], changes=BY_POINT
) -> labels.LabelRecord:
    points = [
        labels.LabelPoint(way if n else "none", n, (error,) * 3, (0.5,) * 3)
        for n, error in errors.items()
        for way in (labels.WAYS if n else ("none",))
    ]
    return labels.LabelRecord(
        TrainingJob(*group, method, 0, changes=changes), "cpu", "c", {}, points=tuple(points)
    )


def test_labels_that_close_a_gap():
    without = label_record((gaps.BASE, gaps.BASE), "source-only", {0: 0.1, 1: 0.1}, AT_RANDOM)
    gap = label_record((gaps.BASE, "modulus-001"), "source-only", {0: 0.2, 1: 0.12, 5: 0.105}, AT_RANDOM)
    rows = {tuple(row[:3]): row[3:] for row in labels.gap_table([gap, without]).rows}
    assert rows["modulus × 0.5", "source-only", "both"] == ["0.200", "0.120", "0.105", "–", "–", "5"]
    assert rows["none", "source-only", "both"][-1] == "0"
    assert rows["modulus × 0.5", "dsan", "both"] == ["–"] * 6
    nine = labels.nine_table([gap, without]).rows
    assert nine[0][:5] == ["source-only", "affine", "0.150", "0.110", "0.105"]


def test_labels_are_drawn_from_the_targets_training_frames(source, target, profile):
    from gelgap.adapt import split_for_training, train_source

    frames = split_for_training(source, target, profile.replace(source_epochs=1), 0)
    model = train_source(frames.source_train, profile.replace(source_epochs=1))
    points = list(labels.label_points(model, frames, 0))
    assert [(point.way, point.labels) for point in points[:4]] == [
        ("none", 0),
        ("affine", 1),
        ("fine-tuning", 1),
        ("both", 1),
    ]
    assert max(point.labels for point in points) == 20  # it has no hundred
    assert len({point.mae_n for point in points}) == len(points) == 10


def test_no_records_is_one_sentence(tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no records of the adaptation benchmark"):
        write_benchmark_report(tmp_path)


def test_gap_errors_are_means_over_seeds(source, monkeypatch):
    monkeypatch.setattr("gelgap.domains.open_domain", lambda folder: source)
    records = [
        RunRecord(
            TrainingJob("mb0i0", "a", "dsan", seed),
            "smoke",
            mae_n=(mae,) * 3,
            constant_mean_n=(4 * mae,) * 3,
        )
        for seed, mae in enumerate((0.1, 0.3))
    ]
    found = gaps.collect(gaps.Design((Gap("modulus", "a", 2.0),), ()), records, Path("x"))
    assert found.errors_n["a"]["dsan"] == pytest.approx(0.2)
    assert found.errors_n["a"]["constant mean"] == pytest.approx(0.8)
    assert gaps.gap_table(found).rows == [["modulus", "2", "0.800", "0.200", "0.000"]]
    assert "Mean over 2 seed" in gaps.gap_table(found).note
