"""The choice without target labels: the rule, its regret, what is frozen, and that nothing compared is seen."""

import math
import tomllib

import pandas as pd
import pytest
from run_records import Record, record, write_runs

from gelgap.adapt import SELECTORS, Profile
from gelgap.benchmarks.adaptation import board, tuning
from gelgap.benchmarks.adaptation.board import (
    GROUPS,
    LIGHT_GROUPS,
    TUNING_CASES,
    TUNING_DOMAINS,
    tuning_recipes,
)
from gelgap.benchmarks.adaptation.study import load_runs
from gelgap.benchmarks.adaptation.tuning import SELECTOR

WEIGHTS = (0.0, 0.003, 0.03, 0.3, 3.0)
TUNING_SETS = {data for data, _ in TUNING_CASES}
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
        method: tuning.chosen(own) for method, own in tuning.of_grid(runs_of(records)).items()
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
    assert set(tuning.of_grid(runs_of([*whole, *part]))["dann"]["group"]) == {" → ".join(TUNING_GROUPS[0])}
    assert chosen([*whole, *part]) == {"dann": WEIGHTS[1]}


def test_a_choice_on_the_edge_is_flagged():
    assert [tuning.edge_of(value, WEIGHTS) for value in (WEIGHTS[0], 0.3, 3.0)] == ["lowest", "", "highest"]


def test_regret_is_the_error_over_the_best(runs_of):
    records = grid([2, 1, 3, 4, 5], [0.1, 0.3, 0.2, 0.4, 0.5])
    found = tuning.of_grid(runs_of(records))["dann"]
    regret_n = found[found["candidate"] == tuning.chosen(found)]["regret_n"]
    assert regret_n.tolist() == pytest.approx([0.2])


def test_the_frozen_choice_is_a_profile(runs_of, tmp_path):
    text = tuning.settings_toml(runs_of(grid([5, 4, 3, 2, 1], [0.1] * 5)))
    assert tomllib.loads(text) == {"settings": {"dann": {"transfer_weight": 3.0}}}
    (tmp_path / "own.toml").write_text(f'base = "smoke"\n{text}')
    assert Profile.load(tmp_path / "own.toml").settings["dann"] == {"transfer_weight": 3.0}


def test_every_method_has_the_same_budget_and_a_setting_that_it_has():
    from gelgap.adapt import find_method

    methods = tuning.tuned_methods()
    runs = tuning.grid_runs(TUNING_CASES, methods, [0])
    assert {m: sum(run["method"] == m for run in runs) for m in methods} == dict.fromkeys(methods, 28)
    grids = {m: find_method(m).grid for m in methods}
    assert all(name in find_method(m).Settings.model_fields for m, (name, _) in grids.items())
    assert {values[0] for _, values in grids.values()} == {0.0}
    with pytest.raises(ValueError, match=r"method 'dsam' is unknown; known methods: .* did you mean dsan\?"):
        tuning.tuned_methods(["dsam"])


def test_the_grid_of_a_method_of_ones_own_is_checked_first(tmp_path):
    from gelgap.adapt.methods.registry import use_method

    file = tmp_path / "graded.py"
    start = "from gelgap.adapt import Method\nclass Mine(Method):\n    grid = "
    file.write_text(start + "('transfer_weight', (0.0, 0.5))\n")
    mine = use_method(f"{file}:Mine")
    runs = tuning.grid_runs(TUNING_CASES[:1], tuning.tuned_methods([mine]), [0])
    assert [run["settings"] for run in runs] == [(("transfer_weight", 0.0),), (("transfer_weight", 0.5),)]
    for name, grid, message in (
        ("low", "('transfer_weight', (-1.0, 0.5))", "greater than or equal to 0"),
        ("down", "('transfer_weight', (0.5, 0.0))", "must rise"),
        ("none", "None", "has no grid"),
    ):
        other = tmp_path / f"graded_{name}.py"
        other.write_text(start + grid)
        with pytest.raises(ValueError, match=message):
            tuning.tuned_methods([use_method(f"{other}:Mine")])


def test_nothing_is_tuned_on_what_is_compared():
    names = {name for group in (*GROUPS, *LIGHT_GROUPS) for name in group}
    compared = board.role_recipes(sorted(names), "target")
    own = {recipe for data in TUNING_SETS for recipe in tuning_recipes(data)}
    assert {recipe.name for recipe in own} == set(TUNING_DOMAINS)
    for part in ("elastomer", "illumination"):
        assert not {getattr(r, part) for r in own} & {getattr(r, part) for r in compared}
    assert {recipe.contacts for recipe in tuning_recipes("tune-independent")} == {"independent"}
    assert {recipe.inpainted_from for recipe in tuning_recipes("tune-paired")} == {None, "mb3i3"}


def test_the_table_of_the_choice(tmp_path):
    assert tuning.PART.tables(tmp_path) == []
    write_runs(tmp_path / tuning.TUNED, grid([2, 1, 3, 4, 5], [0.1, 0.3, 0.2, 0.4, 0.5]))
    (table,) = tuning.PART.tables(tmp_path)
    (row,) = table.cells
    assert row[:5] == ["dann", "0, 0.003, 0.03, 0.3, 3", "2.0, 1.0, 3.0, 4.0, 5.0", "0.003", ""]
    assert row[5:] == ["0.200", "0.200", "1"]
