"""Label-free selection, oracles, evaluation and the tables of a report."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from sklearn.metrics import mean_absolute_error, r2_score

from gelgap.adapt.evaluation import BASELINES, evaluate_predictions
from gelgap.adapt.report import error_table, write_report
from gelgap.adapt.result_table import ResultTable
from gelgap.adapt.run_record import load_runs
from gelgap.adapt.runs import adapt_folders
from gelgap.adapt.selection import (
    SELECTORS,
    Candidate,
    feature_mmd,
    rank_alarm,
    select,
    source_risk,
)

RANGE = np.array([[-0.75, 0.75], [-0.75, 0.75], [-3, 0]])


def candidate(shift: float, error: float = 1.0, spread: float = 1.0) -> Candidate:
    rng = np.random.default_rng(0)
    source_force = rng.standard_normal((150, 3))
    return Candidate(
        source_features=rng.standard_normal((150, 5)),
        source_force_n=source_force,
        source_prediction_n=source_force + error * rng.standard_normal((150, 3)),
        target_features=rng.standard_normal((120, 5)) + shift,
        target_prediction_n=spread * rng.standard_normal((120, 3)),
    )


def test_mae_and_r2_against_scikit_learn():
    rng = np.random.default_rng(0)
    true, predicted = rng.random((50, 3)), rng.random((50, 3))
    result = evaluate_predictions(true, predicted, RANGE)
    np.testing.assert_allclose(result.mae_n, mean_absolute_error(true, predicted, multioutput="raw_values"))
    np.testing.assert_allclose(result.r2, r2_score(true, predicted, multioutput="raw_values"))
    np.testing.assert_allclose(result.mae_percent, np.array(result.mae_n) / [0.015, 0.015, 0.03])


def test_evaluation_of_nothing_or_of_nan():
    with pytest.raises(ValueError, match="n ≥ 1"):
        evaluate_predictions(np.empty((0, 3)), np.empty((0, 3)), RANGE)
    with pytest.raises(ValueError, match="1 of 2 predictions are not finite"):
        evaluate_predictions(np.zeros((2, 3)), np.array([[0, 0, 0], [np.nan, 0, 0]]), RANGE)
    constant = evaluate_predictions(np.zeros((4, 3)), np.ones((4, 3)), RANGE)
    assert np.isnan(constant.r2).all()


def test_source_risk_is_one_less_r2():
    some = candidate(0)
    r2 = r2_score(some.source_force_n, some.source_prediction_n)
    assert source_risk(some) == pytest.approx(1 - r2)


def test_feature_mmd_sees_a_shift():
    assert feature_mmd(candidate(2)) > 5 * feature_mmd(candidate(0))


def test_rank_alarm():
    healthy = candidate(0)
    line = replace(healthy, target_features=np.outer(np.arange(120.0), np.ones(5)))
    assert not rank_alarm(healthy)
    assert rank_alarm(line)


def test_selection_avoids_constant_predictors_and_names_unknown_selectors():
    candidates = [candidate(0, spread=0.01), candidate(1, error=2.0), candidate(2, error=1.0)]
    assert select(candidates, "source-risk") == 2
    assert select(candidates, "feature-mmd") == 1
    assert all(select(candidates, selector) in (1, 2) for selector in SELECTORS)
    broken = replace(candidates[1], source_prediction_n=np.nan * candidates[1].source_prediction_n)
    assert select([broken, candidates[2]], "source-risk") == 1
    with pytest.raises(ValueError, match="known selectors: source-risk, feature-mmd"):
        select(candidates, "luck")
    with pytest.raises(
        ValueError, match=r"'reverse-validation' has left: gelgap 0\.3\.0 is the last version"
    ):
        select(candidates, "reverse-validation")


def test_tables_and_figures(source, target, profile, tmp_path):
    short = profile.replace(source_epochs=1, adapt_epochs=1)
    runs = adapt_folders(source, target, ["source-only", "adabn"], short, out_dir=tmp_path / "runs")
    table = error_table(runs)
    assert sorted(table.columns[1:3]) == ["adabn", "source-only"]
    assert table.columns[0] == "group"
    assert sorted(table.columns[3:]) == sorted(BASELINES)
    best, second, *rules = map(float, table.cells[0][1:])
    assert rules == sorted(rules)
    assert best <= second
    assert table.cells[0][0] == "mb0i0 → wmb1i1"
    assert table.cells[-1] == ["mean", *table.cells[0][1:]]
    assert table.markdown().splitlines()[3] == "| --- |" + 5 * " ---: |"
    page = write_report(tmp_path / "runs").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 2
    assert "mb0i0 → wmb1i1" in page
    assert "mb0i0 → wmb1i1, seed 0: features" in page


def test_profiles_that_differ_are_told_apart_and_judged_on_their_own_frames(
    source, target, profile, tmp_path
):
    short = profile.replace(source_epochs=1, adapt_epochs=1)
    for own, classes in (
        (short, None),
        (short.replace(split_by="point", image_size_px=(32, 32)), None),
        (short, 5),
    ):
        adapt_folders(source, target, ["adabn"], own, classes_from_force=classes, out_dir=tmp_path)
    table = error_table(load_runs(tmp_path))
    own = {name: cell for name, cell in zip(table.columns, table.cells[0], strict=True) if "adabn" in name}
    assert own.keys() == {
        f"adabn, image_size_px={size}, split_by={by}"
        for size, by in (([40, 32], "random"), ([32, 32], "point"))
    }
    assert "errors differ from others in settings, data or weights" in table.note
    assert "adabn, image_size_px" in write_report(tmp_path).read_text(encoding="utf-8")


def test_a_table_shows_the_same_cells_in_every_form(capsys):
    frame = pd.DataFrame({"name_a": ["a → b", "c", "d"], "value": [1 / 3, None, True]}, dtype=object)
    table = ResultTable.of("λ_t & <b>", frame, "A note.")
    assert table.cells == [["a → b", "0.3333"], ["c", "–"], ["d", "yes"]]
    assert "| a → b | 0.3333 |" in table.markdown()
    assert table.markdown().endswith("\nA note.\n")
    assert "<h2>λ_t &amp; &lt;b&gt;</h2>" in table.html()
    assert "<td>a → b</td><td>0.3333</td>" in table.html()
    table.show()
    assert "0.3333" in capsys.readouterr().out
