"""Choosing without target labels: one grid for all, alarms last, one choice for all groups, and what it costs."""

import math
import tomllib

import pytest

from gelgap.adapt import SELECTORS, Profile
from gelgap.benchmarks.adaptation import augmentations, transfer, tuning
from gelgap.benchmarks.adaptation.choice import SELECTOR
from gelgap.benchmarks.adaptation.data_sets import TUNING_CASES, TUNING_DOMAINS, TUNING_SETS, recipes_of
from gelgap.benchmarks.adaptation.jobs import BY_POINT, RunRecord, TrainingJob
from gelgap.benchmarks.adaptation.paper import GROUPS
from gelgap.benchmarks.common.records import append_record

WEIGHTS = tuning.Grid().values
TUNING_GROUPS = [group for _, group in TUNING_CASES]


def candidate(
    value: float, score: float, error: float, group: int = 0, data: str = "tune-paired", **fields
) -> RunRecord:
    groups = TUNING_GROUPS if data in TUNING_SETS else GROUPS
    job = TrainingJob(*groups[group], "dann", 0, data, BY_POINT, (("transfer_weight", value),))
    scores = {**dict.fromkeys(SELECTORS, -score), SELECTOR: score}
    return RunRecord(job, "cpu", mae_n=(error,) * 3, scores=scores, **fields)


def grid(scores: list[float], errors: list[float], **place) -> list[RunRecord]:
    return [candidate(*one, **place) for one in zip(WEIGHTS, scores, errors, strict=True)]


def test_the_least_mean_rank_is_chosen_and_of_equals_the_smaller():
    one = grid([1, 2, 3, 4, 5], [0.1, 0.2, 0.3, 0.4, 0.5])
    other = grid([3, 2, 1, 4, 5], [0.3, 0.1, 0.2, 0.4, 0.5], group=1)
    assert tuning.chosen_values(one) == {"dann": WEIGHTS[0]}
    # Ranks 1 + 3, 2 + 2 and 3 + 1 are equal in the mean.
    assert tuning.chosen_values([*one, *other]) == {"dann": WEIGHTS[0]}
    third = grid([2, 1, 3, 4, 5], [0.1] * 5, group=2)
    assert tuning.chosen_values([*one, *other, *third]) == {"dann": WEIGHTS[1]}


def test_an_alarm_or_a_collapse_is_last_whatever_its_score():
    records = grid([1, 2, 3, 4, 5], [0.1] * 5)
    records[0] = candidate(WEIGHTS[0], 1, 0.1, alarm=True)
    records[1] = candidate(WEIGHTS[1], math.nan, 0.4, problem="the features collapsed")
    assert tuning.chosen_values(records) == {"dann": WEIGHTS[2]}


def test_a_case_counts_only_with_its_whole_grid():
    whole, part = grid([2, 1, 3, 4, 5], [0.1] * 5), grid([1, 2, 3, 4, 5], [0.1] * 5, group=1)[:-1]
    found = tuning.candidates_of([*whole, *part], "dann")
    assert len(found.cases) == 1
    assert tuning.chosen_values([*whole, *part]) == {"dann": WEIGHTS[1]}
    assert tuning.chosen_values(part) == {}
    with pytest.raises(ValueError, match="no group has all candidates yet"):
        tuning.candidates_of(part, "dann").choice()


def test_regret_is_the_error_over_the_best():
    records = grid([2, 1, 3, 4, 5], [0.1, 0.3, 0.2, 0.4, 0.5])
    found = tuning.candidates_of(records, "dann")
    assert found.regret_n(found.choice()) == pytest.approx([0.2])
    assert found.own_regret_n() == pytest.approx([0.2])
    assert found.own_regret_n("IWCV") == pytest.approx([0.4])
    with pytest.raises(
        ValueError, match=r"selector 'reverse' is unknown; known selectors: source risk, IWCV"
    ):
        found.choice("reverse")


def test_the_frozen_choice_is_a_profile(tmp_path):
    text = tuning.settings_toml(grid([5, 4, 3, 2, 1], [0.1] * 5))
    assert tomllib.loads(text) == {"settings": {"dann": {"transfer_weight": 3.0}}}
    (tmp_path / "own.toml").write_text(f'base = "smoke"\n{text}')
    assert Profile.load(tmp_path / "own.toml").settings["dann"] == {"transfer_weight": 3.0}


def test_every_method_has_the_same_budget_and_a_setting_that_it_has():
    from gelgap.adapt import find_method

    methods = tuning.tuned_methods()
    jobs = tuning.grid_jobs(TUNING_CASES, methods, [0])
    assert {m: sum(job.method == m for job in jobs) for m in methods} == dict.fromkeys(methods, 20)
    assert all(tuning.GRIDS[m].setting in find_method(m).Settings.model_fields for m in methods)
    assert all(list(grid.values) == sorted(grid.values) for grid in tuning.GRIDS.values())
    with pytest.raises(
        ValueError, match=r"method 'dsam' is unknown; methods with a grid: .* did you mean dsan\?"
    ):
        tuning.tuned_methods(["dsam"])


def test_nothing_is_tuned_on_what_is_compared():
    compared = {recipe for data in ("paired", "independent") for recipe in recipes_of(data)}
    own = {recipe for data in TUNING_SETS for recipe in recipes_of(data)}
    assert {recipe.name for recipe in own} == set(TUNING_DOMAINS)
    for part in ("elastomer", "illumination"):
        assert not {getattr(r, part) for r in own} & {getattr(r, part) for r in compared}
    assert {recipe.contacts for recipe in recipes_of("tune-independent")} == {"independent"}
    assert {recipe.inpainted_from for recipe in recipes_of("tune-paired")} == {None, "mb3i3"}


def test_tables_of_the_choice_and_of_its_transfer(tmp_path):
    assert tuning.tables(tmp_path) == transfer.tables(tmp_path) == []
    for record in grid([2, 1, 3, 4, 5], [0.1, 0.3, 0.2, 0.4, 0.5]):
        append_record(tmp_path / tuning.RECORD, record)
    for record in grid([1, 2, 3, 4, 5], [0.1, 0.15, 0.2, 0.4, 0.5], data="paired"):
        append_record(tmp_path / transfer.RECORD, record)
    (choice,) = tuning.tables(tmp_path)
    assert choice.rows == [
        [
            *("dann", "transfer_weight", "0.0003, 0.003, 0.03, 0.3, 3", "2.0, 1.0, 3.0, 4.0, 5.0", "0.003"),
            *("0.200", "0.200", "1"),
        ]
    ]
    frozen, selectors = transfer.tables(tmp_path)
    assert frozen.rows[0][3:] == ["0.003", "0.0003", "0.050", "0.050"]
    by_name = {row[0]: row[1:] for row in selectors.rows}
    assert by_name["reverse validation (used)"] == ["0.200", "0.200", "0.050", "0.000"]
    assert by_name["DEV"] == ["0.400", "0.400", "0.400", "0.400"]


def variant(name: str, score: float, mae: float, data: str, group: int = 0) -> RunRecord:
    groups = TUNING_GROUPS if data in TUNING_SETS else GROUPS
    job = TrainingJob(*groups[group], "no-transfer", 0, data, augmentations.VARIANTS[name])
    scores = dict.fromkeys(SELECTORS, score)
    return RunRecord(job, "cpu", mae_n=(mae, mae, 2 * mae), r2=(0.1, 0.2, 0.3), scores=scores)


def test_augmentations_are_chosen_the_same_way(tmp_path):
    scores = {
        **{"none": 5.0, "shifts": 4.0, "shifts, mixed colours": 3.0},
        **{"shifts, hidden markers": 1.0, "all three": 2.0},
    }
    records = [variant(name, score, score / 10, "tune-paired") for name, score in scores.items()]
    records.append(variant("shifts, inputs standardised by domain", 0.0, 0.1, "tune-paired"))
    records.append(variant("all three", 0.0, 0.1, "paired"))
    lines = augmentations.augmentation_toml(records).splitlines()
    assert lines[1:] == ["shift_px = 3", "colour_mixing = 0", "marker_hiding = 0.5"]
    for record in records:
        append_record(tmp_path / augmentations.RECORD, record)
    choice, nine = augmentations.tables(tmp_path)
    rows = {row[0]: row[1:] for row in choice.rows}
    assert rows["shifts, hidden markers"][:4] == ["1.00", "yes", "0.133", "0.100"]
    assert rows["shifts, inputs standardised by domain"][:2] == ["–", ""]
    assert {row[0]: row[1] for row in nine.rows}["all three"] == "0.133"
    assert {row[0]: row[1] for row in nine.rows}["none"] == "–"


def test_variants_change_fields_that_exist():
    for changes in augmentations.VARIANTS.values():
        assert TrainingJob("a", "b", "no-transfer", 0, "paired", changes).profile("cpu").split_by == "point"
