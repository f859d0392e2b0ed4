"""Label-free selection, oracles, evaluation and the tables of a report."""

from dataclasses import replace

import numpy as np
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
    deep_embedded_validation,
    feature_mmd,
    importance_weighted_risk,
    proxy_a_distance,
    rank_alarm,
    reverse_validation,
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


def test_weighted_risks_without_a_shift_are_the_source_risk():
    same = candidate(0)
    assert importance_weighted_risk(same) == pytest.approx(source_risk(same), rel=0.15)
    assert deep_embedded_validation(same) == pytest.approx(source_risk(same), rel=0.1)


def test_discrepancies_see_a_shift():
    assert feature_mmd(candidate(2)) > 5 * feature_mmd(candidate(0))
    assert proxy_a_distance(candidate(3)) > 1.5
    assert proxy_a_distance(candidate(0)) < 0.5


def test_a_discriminator_that_guesses_has_no_a_distance_at_unequal_sizes():
    same = candidate(0)
    few = replace(same, target_features=same.target_features[:15])
    assert proxy_a_distance(few) < 0.5
    assert proxy_a_distance(replace(few, target_features=few.target_features + 3)) > 1.5
    blind = replace(few, source_features=np.ones((150, 5)), target_features=np.ones((15, 5)))
    assert proxy_a_distance(blind) == 0


def test_reverse_validation_knows_features_that_lead_back():
    rng = np.random.default_rng(1)
    source, target = rng.standard_normal((200, 3)), rng.standard_normal((400, 3))

    def predicting(target_force: np.ndarray) -> Candidate:
        return Candidate(source, source, source, target, target_force)

    assert reverse_validation(predicting(target)) < 0.2
    assert reverse_validation(predicting(-target)) > 2
    assert reverse_validation(predicting(np.zeros_like(target))) == pytest.approx(1, abs=0.1)


def test_rank_alarm():
    healthy = candidate(0)
    line = replace(healthy, target_features=np.outer(np.arange(120.0), np.ones(5)))
    assert not rank_alarm(healthy)
    assert rank_alarm(line)


def test_selection_avoids_constant_predictors_and_names_unknown_selectors():
    candidates = [candidate(0, spread=0.01), candidate(1, error=2.0), candidate(2, error=1.0)]
    assert select(candidates, "source risk") == 2
    assert select(candidates, "feature MMD") == 1
    assert all(select(candidates, selector) in (1, 2) for selector in SELECTORS)
    broken = replace(candidates[1], source_prediction_n=np.nan * candidates[1].source_prediction_n)
    assert select([broken, candidates[2]], "source risk") == 1
    with pytest.raises(ValueError, match="known selectors: source risk"):
        select(candidates, "luck")


def test_tables_and_figures(source, target, profile, tmp_path):
    short = profile.replace(source_epochs=1, adapt_epochs=1)
    runs = adapt_folders(source, target, ["source-only", "adabn"], short, out_dir=tmp_path / "runs")
    table = error_table(runs)
    assert sorted(table.columns[1:3]) == ["adabn", "source-only"]
    assert table.columns[0] == "group"
    assert sorted(table.columns[3:]) == sorted(BASELINES)
    best, second, *rules = map(float, table.rows[0][1:])
    assert rules == sorted(rules)
    assert best <= second
    assert table.rows[0][0] == "mb0i0 → wmb1i1"
    assert table.rows[-1] == ["mean", *table.rows[0][1:]]
    assert table.markdown().splitlines()[3] == "| --- |" + 5 * " ---: |"
    assert r"mb0i0 $\to$ wmb1i1" in table.latex()
    page = write_report(tmp_path / "runs").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 2
    assert "mb0i0 → wmb1i1" in page
    assert "![mb0i0 → wmb1i1, seed 0: features" in (tmp_path / "runs" / "report.md").read_text(
        encoding="utf-8"
    )
    assert (tmp_path / "runs" / "tsne-mb0i0-wmb1i1.png").stat().st_size > 1000


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
    own = {name: cell for name, cell in zip(table.columns, table.rows[0], strict=True) if "adabn" in name}
    assert own.keys() == {
        f"adabn, image_size_px={size}, split_by={by}"
        for size, by in (([40, 32], "random"), ([32, 32], "point"))
    }
    assert "errors differ from others in settings, data or weights" in table.note
    assert "adabn, image_size_px" in write_report(tmp_path).read_text(encoding="utf-8")


def test_a_table_shows_the_same_cells_in_every_form(capsys):
    table = ResultTable(
        "λ_t & <b>", ["name_a", "value"], [["a → b", 1 / 3], ["c", None], ["d", True]], "A note."
    )
    assert table.cells == [["a → b", "0.3333"], ["c", "–"], ["d", "yes"]]
    assert "| a → b | 0.3333 |" in table.markdown()
    assert table.markdown().endswith("\nA note.\n")
    assert table.latex().splitlines()[3:6:2] == [r"name\_a & value \\", r"a $\to$ b & 0.3333 \\"]
    assert "<h2>λ_t &amp; &lt;b&gt;</h2>" in table.html()
    assert "<td>a → b</td><td>0.3333</td>" in table.html()
    table.show()
    assert "0.3333" in capsys.readouterr().out
