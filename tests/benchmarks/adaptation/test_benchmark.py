"""The adaptation benchmark: what is missing, what is read back, how methods are compared and chosen."""

import math
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from gelgap.benchmarks.adaptation.groups import jobs_of
from gelgap.benchmarks.adaptation.jobs import (
    RUNS,
    Bench,
    RunRecord,
    TrainingJob,
    missing_jobs,
    run_missing,
)
from gelgap.benchmarks.adaptation.methods import FURTHER_GROUPS
from gelgap.benchmarks.adaptation.paper import GROUPS, PAPER_MAE_N
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.results import (
    GroupOracles,
    Results,
    load_further,
    load_results,
    write_oracles,
)
from gelgap.benchmarks.adaptation.search import (
    WEIGHTS,
    SearchRecord,
    choices,
    regret_table,
    search_jobs,
    weight_table,
)
from gelgap.benchmarks.adaptation.statistics import (
    bootstrap_interval,
    compare,
    critical_difference,
    plot_critical_difference,
    ranks,
)
from gelgap.benchmarks.adaptation.tables import (
    check_table,
    closed_table,
    further_table,
    group_table,
    group_tables,
    shear_table,
    summary_table,
)
from gelgap.benchmarks.common.records import append_record, read_records

ORACLES = {group: GroupOracles((0.01,) * 3, (0.02,) * 3) for group in GROUPS}


def record(source: str, target: str, method: str, mae: float, seed: int = 0) -> RunRecord:
    return RunRecord(
        TrainingJob(source, target, method, seed),
        "cpu",
        {},
        mae_n=(mae,) * 3,
        r2=(0.85, 0.85, 0.95),
        constant_mean_n=(0.4,) * 3,
        source_held_out_r2=(0.9, 0.7, 0.95),
        stage1_s=60.0,
        stage2_s=30.0,
        feature_rank=20.0,
        prediction_spread=0.9,
    )


def results(errors: dict[str, float], seeds: int = 2) -> Results:
    records = [
        record(*group, method, error + 0.01 * seed, seed)
        for group in GROUPS
        for method, error in errors.items()
        for seed in range(seeds)
    ]
    return Results(records, GROUPS, tuple(errors), tuple(range(seeds)), ORACLES)


def test_the_papers_means():
    assert len(GROUPS) == 9
    means = {name: np.mean(values) for name, values in PAPER_MAE_N.items()}
    assert means["source-only"] == pytest.approx(0.290, abs=5e-4)
    assert means["dsan"] == pytest.approx(0.135, abs=5e-4)


def test_only_missing_runs_are_planned_and_a_cut_line_is_ended(tmp_path):
    done = record("mb0i0", "wmb0i0", "dsan", 0.1)
    path = tmp_path / RUNS
    append_record(path, done)
    with path.open("a", encoding="utf-8") as file:
        file.write('{"job": "cut o')
    assert read_records(path, RunRecord) == [done]
    other = replace(done, job=replace(done.job, seed=1, changes=(("transfer_weight", 0.1),)))
    append_record(path, other)
    assert read_records(path, RunRecord) == [done, other]
    jobs = missing_jobs(
        jobs_of(GROUPS[:2], ["source-only", "dsan"], [0]), "cpu", read_records(path, RunRecord)
    )
    assert done.job not in jobs
    assert len(jobs) == 3
    assert len(missing_jobs([done.job, done.job], "smoke", read_records(path, RunRecord))) == 1


def test_work_comes_in_pieces_and_nothing_is_done_twice(tmp_path):
    jobs = jobs_of(GROUPS[:1], ["a", "b", "c"], [0])
    did = []

    def work(bench: Bench, job: TrainingJob) -> RunRecord:
        did.append(job.method)
        return record(job.source, job.target, job.method, 0.1)

    bench = Bench(tmp_path, tmp_path, "cpu", workers=1)
    assert run_missing(replace(bench, stop=time.time()), jobs[:2], work=work) == []
    assert len(run_missing(bench, jobs[:2], work=work)) == 2
    assert len(run_missing(bench, jobs, work=work)) == 3
    assert did == ["a", "b", "c"]


def test_a_jobs_changes_stand_above_the_methods_own_weight():
    from gelgap.adapt import transfer_weight

    job = TrainingJob("a", "b", "dsan", 0, (("transfer_weight", 0.7), ("adapt_epochs", 3)))
    profile = job.profile("cpu")
    assert transfer_weight("dsan", profile) == 0.7
    assert profile.adapt_epochs == 3


def test_summary_beside_the_paper():
    found = results({"source-only": 0.3, "dsan": 0.15, "supervised": 0.05}, seeds=1)
    rows = {row[0]: row for row in summary_table(found).rows}
    assert rows["dsan"][3] == "-50 %"
    assert rows["dsan"][4] == "1.00"
    assert rows["source-only"][4] == "2.00"
    assert rows["dsan"][6] == "-54 %"
    closed = closed_table(found).rows
    assert [row[1] for row in closed] == ["60 %"] * 10


def test_tables_know_what_is_missing_or_collapsed():
    found = results({"source-only": 0.3, "dsan": 0.15, "supervised": 0.05})
    collapsed = [
        replace(ln, problem="the features collapsed", mae_n=(math.nan,) * 3)
        if ln.job == TrainingJob(*GROUPS[0], "dsan", 1)
        else ln
        for ln in found.records
    ]
    table = group_table(replace(found, records=collapsed))
    assert table.rows[0][3] == "0.150 (1 missing)"
    assert table.rows[1][3] == "0.155 ± 0.007"
    titles = [table.title for table in group_tables(replace(found, records=collapsed))]
    assert len(titles) == len(set(titles)) == 9
    shear = {row[0]: row[1:] for row in shear_table(found).rows}
    assert shear["mb0i0 → wmb0i0"] == ["0.85", "0.85", "0.85"]


def test_methods_are_compared_on_what_all_have_finished():
    found = results({"source-only": 0.3, "dsan": 0.15, "supervised": 0.05})
    partial = replace(
        found, records=[ln for ln in found.records if ln.job != TrainingJob(*GROUPS[0], "dsan", 1)]
    )
    assert partial.common.sum() == 17
    assert np.isnan(partial.of("source-only")[0, 1])
    assert partial.of("source-only")[0, 0] == pytest.approx(0.3)
    rows = {row[0]: row for row in summary_table(partial).rows}
    assert rows["dsan"][2] != "–"
    assert "17 of 18" in group_table(partial).note


def test_further_methods_do_not_shrink_the_papers_table(tmp_path):
    paper = {"source-only": 0.3, "dsan": 0.15, "supervised": 0.05}
    for one in results(paper).records:
        append_record(tmp_path / "runs.jsonl", one)
    for group in FURTHER_GROUPS:
        append_record(tmp_path / "runs.jsonl", record(*group, "jan", 0.12))
    write_oracles(tmp_path, ORACLES)
    table, everything = load_results(tmp_path), load_further(tmp_path)
    assert table.methods == list(paper)
    assert table.common.sum() == 18
    assert everything.common.shape == (3, 1)
    assert everything.common.all()
    rows = {row[0]: row for row in further_table(everything).rows}
    assert rows["jan"][1:6] == ["0.120", "0.120", "0.120", "0.120", "-60 %"]
    assert "3 of 3" in further_table(everything).note


def test_a_group_with_a_bad_pose_oracle_is_marked():
    found = results({"source-only": 0.3})
    oracles = {**ORACLES, GROUPS[1]: GroupOracles((0.1, 0.1, 0.2), (0.1,) * 3)}
    table = group_table(replace(found, oracles=oracles))
    assert [row[0].endswith(" *") for row in table.rows] == [i == 1 for i in range(10)]


def test_the_profile_counts_only_with_enough_r2_and_time():
    rows = check_table(results({"source-only": 0.3, "dsan": 0.2, "supervised": 0.1}, seeds=1)).rows
    verdicts = {(row[0], row[1]): row[-1] for row in rows}
    assert verdicts["supervised on target", "wmb2i2"] == "yes"
    assert verdicts["source-only on held-out source", "mb0i0"] == "NO"
    # Three sources of 1 min and two methods on nine groups of 0.5 min, on two cores.
    assert rows[-1][1] == "6.0 min on 2 cores"


def test_bootstrap_interval_holds_the_mean():
    values = np.random.default_rng(0).standard_normal((200, 1))
    low, high = bootstrap_interval(values)
    assert low < values.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(200), rel=0.25)
    ragged = np.concatenate([values, np.where(values > 0, values, np.nan)], axis=1)
    assert bootstrap_interval(ragged) == pytest.approx((low, high), abs=0.05)
    assert math.isnan(bootstrap_interval(np.full((3, 2), math.nan))[0])


def test_paired_comparisons_are_corrected_and_leave_domains_out():
    rng = np.random.default_rng(0)
    base = 0.2 + 0.05 * rng.random((9, 3))
    errors = np.stack(
        [base, base + 0.02 + 0.001 * rng.random((9, 3)), base + 0.01 * rng.standard_normal((9, 3))]
    )
    better, unclear = compare(errors, ["dsan", "worse", "same"], GROUPS, "dsan")
    assert better.p_groups == pytest.approx(2 * 2 / 2**9)
    assert better.p_runs < 1e-5
    assert better.wins == 0
    assert better.leaving_out[0] > 0.019
    assert unclear.p_groups > 0.05
    errors[:, 0, 0] = math.nan
    assert len(compare(errors, ["dsan", "worse", "same"], GROUPS, "dsan")) == 2
    errors[1, 1, 0] = math.nan
    assert [c.first for c in compare(errors, ["dsan", "worse", "same"], GROUPS, "dsan")] == ["same"]


def test_a_missing_package_is_named_before_anything_is_measured(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "scikit_posthocs", None)
    part = Part(measure=lambda bench: pytest.fail("measured"), tables=lambda folder: [])
    with pytest.raises(ModuleNotFoundError, match=r"pip install gelgap\[benchmark\]"):
        part.run(quick=True, out_dir=tmp_path)


def test_ranks_and_critical_difference():
    assert ranks(np.array([[0.1, math.nan], [0.2, 0.3], [0.2, 0.4]])).tolist() == [[1, 3], [2.5, 1], [2.5, 2]]
    # Demšar 2006, table 5: q = 2.343 for three methods, 2.569 for four.
    assert critical_difference(4, 14) == pytest.approx(2.569 * np.sqrt(4 * 5 / (6 * 14)), rel=1e-3)


def test_methods_that_the_test_does_not_tell_apart_are_joined():
    # Mean ranks 1, 2, 3.1 and 3.9 over ten cases; the critical difference is 1.48.
    errors = np.array([[0.1] * 10, [0.2] * 10, [0.3] * 9 + [0.4], [0.4] * 9 + [0.3]])
    (axes,) = plot_critical_difference(["a", "b", "c", "d"], errors, "ranks").axes
    texts = {text.get_text() for text in axes.texts}
    assert {"a  1.00", "b  2.00", "3.10  c", "3.90  d", "CD = 1.5"} <= texts
    bars = [line.get_xdata() for line in axes.lines if len(set(line.get_ydata())) == 1]
    joined = {(round(min(x), 1), round(max(x), 1)) for x in bars}
    assert joined == {(1.0, 2.0), (2.0, 3.1), (3.1, 3.9), (1.0, 2.5)}  # the last one is the difference itself


def search_record(
    weight: float, error: tuple, score: tuple, alarms=(False, False), problem=None
) -> SearchRecord:
    from gelgap.adapt import SELECTORS

    job = TrainingJob("a", "b", "dsan", 0, (("transfer_weight", weight),))
    return SearchRecord(job, "cpu", (2, 4), error, dict.fromkeys(SELECTORS, score), alarms, problem)


def test_choices_over_weights_and_epochs():
    lines = [
        search_record(0.003, (0.3, 0.25), (5.0, 4.0)),
        search_record(0.03, (0.2, 0.1), (3.0, 2.0)),
        search_record(0.3, (0.5, 0.6), (0.1, 0.1), alarms=(True, True)),
        SearchRecord(
            TrainingJob("a", "b", "dsan", 0, (("transfer_weight", 3.0),)), "cpu", problem="collapsed"
        ),
    ]
    found = {choice.rule: choice for choice in choices(lines)}
    assert found["target labels (oracle)"].error_n == 0.1
    assert found["last epoch, profile's weight"].regret_n == pytest.approx(0.15)
    assert (found["IWCV"].weight, found["IWCV"].epoch) == (0.03, 4)
    by_weight = weight_table(lines)
    assert by_weight.columns[1:] == [f"λ_t = {weight:g}" for weight in WEIGHTS]
    assert by_weight.rows[0][1:] == ["–", "0.250", "0.100", "0.600", "(1 of 1 collapsed)"]
    assert {row[0]: row[-1] for row in regret_table(lines).rows}["DEV"] == "0.000"


def test_every_method_has_the_same_budget():
    jobs = search_jobs(GROUPS[:2], ["dann", "dsan"], [0, 1])
    per_method = {m: sum(job.method == m for job in jobs) for m in ("dann", "dsan")}
    assert per_method == {"dann": 4 * len(WEIGHTS), "dsan": 4 * len(WEIGHTS)}
