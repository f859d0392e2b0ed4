"""The adaptation benchmark: what is missing, what is read back, how methods are compared with their controls."""

import math
import sys
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gelgap.benchmarks.adaptation import running
from gelgap.benchmarks.adaptation.compared import MAIN_METHODS, METHODS
from gelgap.benchmarks.adaptation.groups import SEEDS, headline_jobs, jobs_of
from gelgap.benchmarks.adaptation.headline_tables import (
    adabn_table,
    check_table,
    control_table,
    group_table,
    group_tables,
    headline_table,
    order_table,
    split_table,
)
from gelgap.benchmarks.adaptation.jobs import AT_RANDOM, BY_POINT, RUNS, Bench, RunRecord, TrainingJob
from gelgap.benchmarks.adaptation.paper import GROUPS, PAPER_MAE_N
from gelgap.benchmarks.adaptation.parts import Part
from gelgap.benchmarks.adaptation.results import GroupOracles, Results, load_results, write_oracles
from gelgap.benchmarks.adaptation.running import missing_jobs, run_missing
from gelgap.benchmarks.adaptation.statistics import (
    bootstrap_interval,
    critical_difference,
    kendall_tau,
    paired_difference,
    plot_critical_difference,
    ranks,
)
from gelgap.benchmarks.adaptation.work import control_of
from gelgap.benchmarks.common.records import append_record, read_records

ORACLES = {group: GroupOracles((0.01,) * 3, (0.02,) * 3) for group in GROUPS}


def record(
    group: tuple[str, str], method: str, mae: float, seed: int = 0, data: str = "paired", **fields
) -> RunRecord:
    values = {
        "changes": BY_POINT,
        "mae_n": (mae,) * 3,
        "r2": (0.85, 0.85, 0.95),
        "constant_mean_n": (0.4,) * 3,
        "source_held_out_r2": (0.9, 0.7, 0.95),
        "stage1_s": 60.0,
        "stage2_s": 30.0,
        **fields,
    }
    job = TrainingJob(*group, method, seed, data, values.pop("changes"))
    return RunRecord(job, "cpu", configuration="c", control=control_of(method), **values)


def records(errors: dict[str, float], seeds: int = 2, **fields) -> list[RunRecord]:
    return [
        record(group, method, error + 0.01 * seed, seed, **fields)
        for group in GROUPS
        for method, error in errors.items()
        for seed in range(seeds)
    ]


def results(errors: dict[str, float], seeds: int = 2) -> Results:
    return Results(records(errors, seeds), GROUPS, tuple(errors), tuple(range(seeds)))


def rows_of(table) -> dict[str, dict[str, str]]:
    return {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}


def written(folder: Path, runs: Iterable[RunRecord]) -> Path:
    for one in runs:
        append_record(folder / RUNS, one)
    write_oracles(folder, ORACLES)
    return folder


def test_the_papers_means():
    assert len(GROUPS) == 9
    means = {name: np.mean(values) for name, values in PAPER_MAE_N.items()}
    assert means["source-only"] == pytest.approx(0.290, abs=5e-4)
    assert means["dsan"] == pytest.approx(0.135, abs=5e-4)
    assert list(means) == sorted(means, key=means.get, reverse=True)


def test_a_stop_at_any_time_leaves_complete_seeds():
    jobs = headline_jobs(GROUPS, METHODS, SEEDS)
    assert len(jobs) == len(set(jobs)) == 5 * 2 * 9 * len(METHODS)
    assert [job.seed for job in jobs] == sorted(job.seed for job in jobs)
    first = [job for job in jobs if job.seed == 0]
    assert {(job.data, job.group) for job in first} == {
        (d, g) for d in ("paired", "independent") for g in GROUPS
    }
    assert {job.profile("cpu").split_by for job in jobs} == {"point"}


def test_every_method_is_held_against_its_own_control():
    assert {method: control_of(method) for method in MAIN_METHODS} == {
        "source-only": None,
        "adabn": "source-only",
        "no-transfer": "adabn",
        "classifier-only": "no-transfer",
        "dann": "no-transfer",
        "daregram": "no-transfer",
        "dsan": "classifier-only",
        "supervised": None,
    }
    assert control_of("ssa") == control_of("tasfar") == "adabn"
    assert control_of("dsan-soft") == "no-transfer"


def test_only_missing_runs_are_planned_and_a_cut_line_is_ended(tmp_path):
    done = record(GROUPS[0], "dsan", 0.1)
    path = tmp_path / RUNS
    append_record(path, done)
    with path.open("a", encoding="utf-8") as file:
        file.write('{"job": "cut o')
    assert read_records(path, RunRecord) == [done]
    other = replace(done, job=replace(done.job, seed=1, settings=(("transfer_weight", 0.1),)))
    append_record(path, other)
    assert read_records(path, RunRecord) == [done, other]
    wanted = jobs_of("paired", GROUPS[:2], ["source-only", "dsan"], [0], BY_POINT)
    jobs = missing_jobs(wanted, "cpu", read_records(path, RunRecord))
    assert done.job not in jobs
    assert len(jobs) == 3
    assert len(missing_jobs([done.job, done.job], "smoke", read_records(path, RunRecord))) == 1


@pytest.fixture
def same_configuration(monkeypatch):
    monkeypatch.setattr(running, "configuration_of", lambda bench, job: "c")


def test_work_comes_in_pieces_and_nothing_is_done_twice(tmp_path, same_configuration):
    jobs = jobs_of("paired", GROUPS[:1], ["dan", "dann", "dsan"], [0], BY_POINT)
    did = []

    def work(bench: Bench, job: TrainingJob) -> RunRecord:
        did.append(job.method)
        return replace(
            record(job.group, job.method, 0.1), settings=job.profile("cpu").settings.get(job.method, {})
        )

    bench = Bench(tmp_path, tmp_path, "cpu", workers=1)
    assert run_missing(replace(bench, stop=time.time()), jobs[:2], RUNS, work) == []
    assert len(run_missing(bench, jobs[:2], RUNS, work)) == 2
    assert len(run_missing(bench, jobs, RUNS, work)) == 3
    assert did == ["dan", "dann", "dsan"]


def test_records_of_another_configuration_are_not_gone_on_from(tmp_path, same_configuration):
    bench = Bench(tmp_path, tmp_path, "cpu", workers=1)
    for differs in ({"configuration": "d"}, {"settings": {"transfer_weight": 0.7}}):
        path = tmp_path / RUNS
        path.unlink(missing_ok=True)
        append_record(path, replace(record(GROUPS[0], "jan", 0.1), **differs))
        jobs = jobs_of("paired", GROUPS[:1], ["jan"], [0], BY_POINT)
        with pytest.raises(
            ValueError, match="of another configuration than profile cpu and the data have now"
        ):
            run_missing(bench, jobs, RUNS, lambda bench, job: pytest.fail("measured"))


def test_data_of_another_kind_say_themselves_what_their_configuration_is(tmp_path):
    bench = Bench(tmp_path, tmp_path, "cpu", workers=1)
    (job,) = jobs_of("paired", GROUPS[:1], ["source-only"], [0], BY_POINT)
    append_record(tmp_path / RUNS, replace(record(GROUPS[0], "source-only", 0.1), configuration="own"))

    def found(configuration: str):
        work = lambda bench, job: pytest.fail("measured")  # noqa: E731
        return run_missing(bench, [job], RUNS, work, configuration=lambda bench, job: configuration)

    assert len(found("own")) == 1
    with pytest.raises(ValueError, match="of another configuration"):
        found("other")


def test_records_of_two_configurations_are_not_compared(tmp_path):
    other = replace(record(GROUPS[0], "dann", 0.1), configuration="d")
    folder = written(tmp_path, [record(GROUPS[0], "dan", 0.1), other])
    with pytest.raises(ValueError, match="only runs of one profile and of the same data can be compared"):
        load_results(folder)


def test_a_jobs_settings_stand_above_the_methods_own():
    from gelgap.adapt import transfer_weight

    job = TrainingJob(
        "a", "b", "daregram", 0, changes=(("adapt_epochs", 3),), settings=(("transfer_weight", 0.7),)
    )
    profile = job.profile("cpu")
    assert transfer_weight("daregram", profile) == 0.7
    assert profile.adapt_epochs == 3
    assert TrainingJob("a", "b", "source-only", 0).profile("cpu").settings == {}


def test_methods_beside_their_controls():
    errors = {"source-only": 0.3, "no-transfer": 0.2, "classifier-only": 0.18, "dann": 0.19, "dsan": 0.15}
    rows, against = (rows_of(table(results(errors), "paired")) for table in (headline_table, control_table))
    assert against["dsan"]["control"] == "classifier-only"
    assert against["dsan"]["difference, N"] == "-0.0300"
    assert against["dsan"]["95 % interval"] == "-0.0300…-0.0300"
    assert against["dann"]["difference, N"] == "-0.0100"
    assert against["dsan"]["better in"] == "9 of 9"
    assert "no-transfer" not in against  # AdaBN was not run
    assert [rows[m]["rank"] for m in errors] == ["5.0", "4.0", "2.0", "3.0", "1.0"]
    assert [rows[m]["without source-only"] for m in errors] == ["–", "4.0", "2.0", "3.0", "1.0"]


def test_a_collapsed_run_counts_with_what_it_became():
    found = results({"source-only": 0.3, "dsan": 0.15})
    collapsed = [
        replace(one, problem="the features collapsed", mae_n=(0.4,) * 3)
        if one.job == TrainingJob(*GROUPS[0], "dsan", 1, changes=BY_POINT)
        else one
        for one in found.records
    ]
    found = replace(found, records=collapsed)
    assert found.of("dsan")[0].tolist() == pytest.approx([0.15, 0.4])
    assert rows_of(headline_table(found, "paired"))["dsan"]["collapsed"] == "1"


def test_methods_are_compared_on_what_all_have_finished():
    found = results({"source-only": 0.3, "dsan": 0.15, "supervised": 0.05})
    left_out = TrainingJob(*GROUPS[0], "dsan", 1, changes=BY_POINT)
    partial = replace(found, records=[one for one in found.records if one.job != left_out])
    assert partial.common.sum() == 17
    assert np.isnan(partial.of("source-only")[0, 1])
    assert partial.of("source-only")[0, 0] == pytest.approx(0.3)
    assert "17 of 18" in headline_table(partial, "paired").note


def test_groups_in_which_source_only_is_worse_than_the_constant_mean_are_marked():
    found = results({"source-only": 0.3, "dsan": 0.15}, seeds=1)
    runs = [
        replace(one, mae_n=(0.5,) * 3)
        if (one.job.group, one.job.method) == (GROUPS[2], "source-only")
        else one
        for one in found.records
    ]
    oracles = {**ORACLES, GROUPS[1]: GroupOracles((0.1, 0.1, 0.2), (0.1,) * 3)}
    table = group_table(replace(found, records=runs), "paired", oracles)
    assert [row[0].endswith(" †") for row in table.rows] == [i == 2 for i in range(10)]
    assert [row[0].endswith(" *") for row in table.rows] == [i == 1 for i in range(10)]
    assert "1 of 9 groups" in table.note


def test_the_share_of_batch_normalisation():
    found = results({"source-only": 0.3, "adabn": 0.2, "dsan": 0.1, "coral": 0.35}, seeds=1)
    rows = rows_of(adabn_table({"paired": found}))
    assert rows["dsan"]["paired: AdaBN's share"] == "50 %"
    assert rows["dsan"]["paired: change from source-only"] == "-67 %"
    assert rows["coral"]["paired: AdaBN's share"] == "–"


def test_the_papers_order():
    found = results({"source-only": 0.3, "dann": 0.15, "daregram": 0.2, "dsan": 0.1}, seeds=1)
    row = order_table({"paired": found}).rows[0]
    assert row == ["mb0i0 → wmb0i0", "source-only > daregram > dann > dsan", "+0.67", "no"]
    assert kendall_tau([4, 3, 2, 1]) == pytest.approx(1)
    assert kendall_tau([1, 2, 3, 4]) == pytest.approx(-1)


def test_splits_side_by_side():
    at_random, by_point = (results({"source-only": 0.3, "dsan": error}, seeds=1) for error in (0.1, 0.15))
    assert split_table(at_random, by_point).rows[1] == ["dsan", "0.100", "0.150", "1.50", "1", "1"]


def test_all_tables_of_both_designs(tmp_path):
    errors = {
        "source-only": 0.3,
        "adabn": 0.2,
        "dann": 0.16,
        "daregram": 0.15,
        "dsan": 0.14,
        "supervised": 0.05,
    }
    folder = written(
        tmp_path,
        [
            *records(errors),
            *records(errors, data="independent"),
            *records({"dsan": 0.1}, changes=AT_RANDOM),
            record(GROUPS[0], "jan", 0.1),
        ],
    )
    titles = [table.title for table in group_tables(folder)]
    assert len(titles) == len(set(titles)) == 16
    assert load_results(folder).methods == [
        "source-only",
        "adabn",
        "jan",
        "dann",
        "daregram",
        "dsan",
        "supervised",
    ]


def test_the_profile_counts_only_with_enough_r2():
    rows = check_table(results({"source-only": 0.3, "dsan": 0.2, "supervised": 0.1}, seeds=1), "paired").rows
    verdicts = {(row[0], row[1]): row[-1] for row in rows}
    assert verdicts["supervised on target", "wmb2i2"] == "yes"
    assert verdicts["source-only on held-out source", "mb0i0"] == "NO"


def test_bootstrap_interval_holds_the_mean():
    values = np.random.default_rng(0).standard_normal((200, 1))
    low, high = bootstrap_interval(values)
    assert low < values.mean() < high
    assert high - low == pytest.approx(2 * 1.96 / np.sqrt(200), rel=0.25)
    ragged = np.concatenate([values, np.where(values > 0, values, np.nan)], axis=1)
    assert bootstrap_interval(ragged)[0] < values.mean() < bootstrap_interval(ragged)[1]
    assert math.isnan(bootstrap_interval(np.full((3, 2), math.nan))[0])


def test_seeds_that_shift_all_groups_widen_the_interval():
    rng = np.random.default_rng(0)
    own, shared = rng.standard_normal((9, 5)), np.broadcast_to(rng.standard_normal(5), (9, 5))
    (low, high), (low_shared, high_shared) = bootstrap_interval(own), bootstrap_interval(shared)
    assert high_shared - low_shared > 1.5 * (high - low)


def test_paired_differences_leave_domains_out():
    rng = np.random.default_rng(0)
    base = 0.2 + 0.5 * rng.random((9, 3))
    worse = paired_difference(base + 0.02 + 0.001 * rng.random((9, 3)), base, GROUPS)
    assert worse.mean_n == pytest.approx(0.0205, abs=5e-4)
    assert worse.interval_n[0] > 0.02
    assert worse.better == 0
    assert worse.leaving_out_n[0] > 0.02
    missing = base.copy()
    missing[0, 0] = math.nan
    assert paired_difference(missing, base, GROUPS).mean_n == pytest.approx(0)


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
