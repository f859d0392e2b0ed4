"""The benchmark's other parts: designs of gap curves, factorial effects, ablation, costs, and the report of all."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gelgap.adapt import adapt_frames
from gelgap.benchmarks.adaptation import ablation, cost, gaps, speed
from gelgap.benchmarks.adaptation.figures import prediction_figures
from gelgap.benchmarks.adaptation.gaps import CrossedCell, Gap, GapResults, design, effects
from gelgap.benchmarks.adaptation.jobs import RUNS, RunRecord, TrainingJob
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


def test_ablation_changes_fields_that_exist():
    jobs = ablation.ablation_jobs(GROUPS[:1], [0])
    assert len({(job.method, job.changes) for job in jobs}) == len(ablation.variations())
    profiles = [job.profile("cpu") for job in jobs]
    assert {profile.transfer_weight for profile in profiles} >= {0.003, 1.0}


def test_cheaper_data_differ_as_they_say():
    standard, independent = (
        cost.recipes(name)[0] for name in ("standard", "draft physics, independent contacts")
    )
    assert standard.quality == "standard"
    assert (independent.quality, independent.contacts) == ("draft", "independent")
    assert len(independent.path.poses) == len(standard.path.poses)


def test_report_of_all_parts(tmp_path):
    folder = tmp_path / "cpu"
    rng = np.random.default_rng(0)
    assert not is_benchmark(folder)
    for group in GROUPS:
        for method in ("source-only", "dann", "dsan", "supervised"):
            for seed in (0, 1):
                mae = tuple((0.1 + 0.1 * rng.random(3)).tolist())
                job = TrainingJob(*group, method, seed)
                line = RunRecord(
                    job, "cpu", {}, mae_n=mae, r2=(0.9,) * 3, constant_mean_n=(0.4,) * 3, stage2_s=3.0
                )
                append_record(folder / RUNS, line)
    write_oracles(folder, {group: GroupOracles((0.01,) * 3, (0.02,) * 3) for group in GROUPS})
    variation = ablation.variations()[0]
    job = TrainingJob(*ablation.GROUPS[0], variation.method, 0, variation.changes)
    append_record(folder / ablation.RECORD, RunRecord(job, "cpu", {}, problem="the features collapsed"))
    write_json(folder / gaps.RESULTS, crossed(lambda c: 0.1))
    errors = {method: [0.2, 0.3] for method in cost.METHODS}
    costs = [cost.Cost("standard", 200, 1.0, 8, errors, 60.0)]
    write_json(folder / cost.RESULTS, costs)
    loops = [speed.Speed(name, 40.0, 0.01, 0.02) for name in ("stage 1", "stage 2, supervised")]
    write_json(folder / speed.RESULTS, loops)
    page = write_benchmark_report(folder, tmp_path / "out").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 4
    text = Path(tmp_path / "out" / "adaptation.md").read_text(encoding="utf-8")
    for expected in (
        "critical difference",
        "Effects and interactions",
        "collapsed",
        "![Mean ranks",
        "pose oracle",
        "25.0 | +2.0 %",
    ):
        assert expected in text
    latex = Path(tmp_path / "out" / "adaptation.tex").read_text(encoding="utf-8")
    assert not set("→±×≥…²λ") & set("".join(ln for ln in latex.splitlines() if not ln.startswith("%")))


def test_figures_show_only_the_tables_runs_of_the_shown_methods(source, target, profile, tmp_path):
    short = profile.replace(source_epochs=1, adapt_epochs=1)
    runs = adapt_frames(target, source, ["source-only", "dsan-coarse"], short, out_dir=tmp_path)
    write_oracles(tmp_path, {(target.name, source.name): GroupOracles((0.01,) * 3, (0.02,) * 3)})
    job = TrainingJob(target.name, source.name, "source-only", 0)
    append_record(tmp_path / RUNS, RunRecord(job, "cpu", {}, key="another run's"))
    assert prediction_figures(tmp_path) == []
    for run in runs:
        append_record(tmp_path / RUNS, RunRecord(replace(job, method=run.method), "cpu", {}, key=run.key))
    scatter, _ = prediction_figures(tmp_path)
    assert [axes.get_title().partition(":")[0] for axes in scatter.figure.axes] == ["source-only"] * 3


def test_no_records_is_one_sentence(tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no records of the adaptation benchmark"):
        write_benchmark_report(tmp_path)


def test_gap_errors_are_means_over_seeds(source, monkeypatch):
    monkeypatch.setattr("gelgap.domains.open_domain", lambda folder: source)
    records = [
        RunRecord(
            TrainingJob("mb0i0", "a", "dsan", seed),
            "smoke",
            {},
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
