"""The choice without target labels: the rule, its regret, what is frozen, and that nothing compared is seen."""

import math
import tomllib
from pathlib import Path

import pandas as pd
import pytest
from run_records import Record, record, write_runs

from gelgap.adapt import SELECTORS, Profile
from gelgap.benchmarks.adaptation import choice
from gelgap.benchmarks.adaptation.board import GROUPS, TUNING_CASES, TUNING_DOMAINS, TUNING_SETS, recipes_of
from gelgap.benchmarks.adaptation.choice import GRIDS, SELECTOR
from gelgap.benchmarks.adaptation.study import Study, load_runs

WEIGHTS = GRIDS["dann"][1]
TUNING_GROUPS = [group for _, group in TUNING_CASES]


def candidate(
    value: float, score: float, error: float, group: int = 0, data: str = "tune-paired", **fields
) -> Record:
    groups = TUNING_GROUPS if data in TUNING_SETS else GROUPS
    fields = {"scores": {**dict.fromkeys(SELECTORS, -score), SELECTOR: score}, "alarm": False} | fields
    setting = (("transfer_weight", value),)
    return record(groups[group], "dann", error, data=data, candidate=setting, **fields)


def grid(scores: list[float], errors: list[float], **place) -> list[Record]:
    return [candidate(*one, **place) for one in zip(WEIGHTS, scores, errors, strict=True)]


@pytest.fixture
def runs_of(tmp_path):
    """Records as a table."""
    files = (tmp_path / f"{number}.jsonl" for number in range(9))

    def load(records: list[Record]) -> pd.DataFrame:
        file = next(files)
        write_runs(file, records)
        return load_runs(file)

    return load


@pytest.fixture
def chosen(runs_of):
    """The value that is chosen for each method."""
    return lambda records: {
        method: choice.chosen(own) for method, own in choice.of_grid(runs_of(records)).items()
    }


def test_the_least_mean_rank_is_chosen_and_of_equals_the_smaller(chosen):
    one = grid([1, 2, 3, 4, 5], [0.1, 0.2, 0.3, 0.4, 0.5])
    other = grid([3, 2, 1, 4, 5], [0.3, 0.1, 0.2, 0.4, 0.5], group=1)
    assert chosen(one) == {"dann": WEIGHTS[0]}
    # Ranks 1 + 3, 2 + 2 and 3 + 1 are equal in the mean.
    assert chosen([*one, *other]) == {"dann": WEIGHTS[0]}
    third = grid([2, 1, 3, 4, 5], [0.1] * 5, group=2)
    assert chosen([*one, *other, *third]) == {"dann": WEIGHTS[1]}


def test_an_alarm_or_a_collapse_is_last_whatever_its_score(chosen):
    records = grid([1, 2, 3, 4, 5], [0.1] * 5)
    records[0] = candidate(WEIGHTS[0], 1, 0.1, alarm=True)
    records[1] = candidate(WEIGHTS[1], math.nan, 0.4, problem="the features collapsed")
    assert chosen(records) == {"dann": WEIGHTS[2]}


def test_a_case_counts_only_with_its_whole_grid(chosen, runs_of):
    whole, part = grid([2, 1, 3, 4, 5], [0.1] * 5), grid([1, 2, 3, 4, 5], [0.1] * 5, group=1)[:-1]
    assert len(choice.of_grid(runs_of([*whole, *part]))["dann"]) == 1
    assert chosen([*whole, *part]) == {"dann": WEIGHTS[1]}
    assert chosen(part) == {}


def test_regret_is_the_error_over_the_best(runs_of):
    records = grid([2, 1, 3, 4, 5], [0.1, 0.3, 0.2, 0.4, 0.5])
    found = choice.of_grid(runs_of(records))["dann"]
    assert found["regret_n"][choice.chosen(found)].tolist() == pytest.approx([0.2])
    assert choice.regret_anew_n(found) == pytest.approx([0.2])
    assert choice.regret_anew_n(found, "IWCV") == pytest.approx([0.4])


def test_the_frozen_choice_is_a_profile(runs_of, tmp_path):
    text = choice.settings_toml(runs_of(grid([5, 4, 3, 2, 1], [0.1] * 5)))
    assert tomllib.loads(text) == {"settings": {"dann": {"transfer_weight": 3.0}}}
    (tmp_path / "own.toml").write_text(f'base = "smoke"\n{text}')
    assert Profile.load(tmp_path / "own.toml").settings["dann"] == {"transfer_weight": 3.0}


def test_every_method_has_the_same_budget_and_a_setting_that_it_has():
    from gelgap.adapt import find_method

    methods = choice.tuned_methods()
    runs = choice.grid_runs(TUNING_CASES, methods, [0])
    assert {m: sum(run["method"] == m for run in runs) for m in methods} == dict.fromkeys(methods, 20)
    assert all(GRIDS[m][0] in find_method(m).Settings.model_fields for m in methods)
    assert all(list(values) == sorted(values) for _, values in GRIDS.values())
    with pytest.raises(
        ValueError, match=r"method 'dsam' is unknown; methods with a grid: .* did you mean dsan\?"
    ):
        choice.tuned_methods(["dsam"])


def test_nothing_is_tuned_on_what_is_compared():
    compared = {recipe for data in ("paired", "independent") for recipe in recipes_of(data)}
    own = {recipe for data in TUNING_SETS for recipe in recipes_of(data)}
    assert {recipe.name for recipe in own} == set(TUNING_DOMAINS)
    for part in ("elastomer", "illumination"):
        assert not {getattr(r, part) for r in own} & {getattr(r, part) for r in compared}
    assert {recipe.contacts for recipe in recipes_of("tune-independent")} == {"independent"}
    assert {recipe.inpainted_from for recipe in recipes_of("tune-paired")} == {None, "mb3i3"}


def test_tables_of_the_choice_and_of_its_transfer(tmp_path):
    assert choice.TUNE.tables(tmp_path) == choice.TRANSFER.tables(tmp_path) == []
    write_runs(tmp_path / choice.TUNED, grid([2, 1, 3, 4, 5], [0.1, 0.3, 0.2, 0.4, 0.5]))
    on_nine = grid([1, 2, 3, 4, 5], [0.1, 0.15, 0.2, 0.4, 0.5], data="paired")
    write_runs(tmp_path / choice.NINE_GROUPS, on_nine)
    (table,) = choice.TUNE.tables(tmp_path)
    assert table.cells == [
        [
            *("dann", "transfer_weight", "0.0003, 0.003, 0.03, 0.3, 3", "2.0, 1.0, 3.0, 4.0, 5.0", "0.003"),
            *("0.200", "0.200", "1"),
        ]
    ]
    frozen, selectors = choice.TRANSFER.tables(tmp_path)
    assert frozen.rows[0][3:] == ["0.003", "0.0003", "0.050", "0.050"]
    by_name = {row[0]: row[1:] for row in selectors.rows}
    assert by_name["reverse validation (used)"] == ["0.200", "0.200", "0.050", "0.000"]
    assert by_name["DEV"] == ["0.400", "0.400", "0.400", "0.400"]


def variant(name: str, score: float, mae: float, data: str) -> Record:
    group = (TUNING_GROUPS if data in TUNING_SETS else GROUPS)[0]
    fields = {"scores": dict.fromkeys(SELECTORS, score), "alarm": False, "mae_n": (mae, mae, 2 * mae)}
    return record(group, "no-transfer", mae, data=data, changes=choice.VARIANTS[name], **fields)


def test_augmentations_are_chosen_the_same_way(tmp_path):
    scores = {
        **{"none": 5.0, "shifts": 4.0, "shifts, mixed colours": 3.0},
        **{"shifts, hidden markers": 1.0, "all three": 2.0},
    }
    assert choice.AUGMENT.tables(tmp_path) == []
    records = [variant(name, score, score / 10, "tune-paired") for name, score in scores.items()]
    records.append(variant("shifts, inputs standardised by domain", 0.0, 0.1, "tune-paired"))
    records.append(variant("all three", 0.0, 0.1, "paired"))
    write_runs(tmp_path / choice.AUGMENTATIONS, records)
    lines = choice.augmentation_toml(load_runs(tmp_path / choice.AUGMENTATIONS)).splitlines()
    assert lines[1:] == ["shift_px = 3", "colour_mixing = 0", "marker_hiding = 0.5"]
    on_tuning, nine = choice.AUGMENT.tables(tmp_path)
    rows = {row[0]: row[1:] for row in on_tuning.cells}
    assert rows["shifts, hidden markers"][:4] == ["1.00", "yes", "0.133", "0.100"]
    assert rows["shifts, inputs standardised by domain"][:2] == ["–", ""]
    assert {row[0]: row[1] for row in nine.cells}["all three"] == "0.133"
    assert {row[0]: row[1] for row in nine.cells}["none"] == "–"


def test_variants_change_fields_that_exist():
    study = Study(Path(), Path(), "cpu")
    for run in choice.variant_runs(TUNING_CASES, ["no-transfer"], [0]):
        assert study.profile_of(run).split_by == "point"
