"""What a factor of randomisation is worth: the table of differences, and the quick form."""

from pathlib import Path

import numpy as np
import pytest
from real_clones import write_wedge_clone

from gelgap.benchmarks.common.records import read_records
from gelgap.benchmarks.real.few_label_draws import Budget
from gelgap.benchmarks.real.few_label_runs import RUNS
from gelgap.benchmarks.real.network_runs import FoldRecord
from gelgap.benchmarks.real.pretraining import BudgetResults
from gelgap.benchmarks.real.randomisation import factor_table
from gelgap.benchmarks.real.starts import PRETRAINED, without
from gelgap.cli.main import main


def test_a_factor_that_helps_has_a_positive_difference():
    errors_n = np.full((4, 3), 2.0)
    start = without("light")
    found = [BudgetResults(Budget(frames=16), {PRETRAINED: errors_n, start: 1.5 * errors_n})]
    table = factor_table(found, [PRETRAINED, start])
    assert table.rows == [
        [PRETRAINED, "2.00", "–", "–"],
        ["without-light", "3.00", "+50 %", "+50…+50"],
    ]


def test_the_quick_form_pretrains_without_a_factor(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    write_wedge_clone(tmp_path / "clones/EstimateModulus")
    places = ("--data", str(tmp_path / "clones"), "--out", str(tmp_path / "out"))
    main(["benchmark", "real", "--what", "randomisation", "--quick", *places])
    assert "without-gel" in capsys.readouterr().out
    folder = tmp_path / "out/real/pretraining-smoke"
    assert (folder / "without-gel/pretrained.pt").read_bytes() != (
        folder / "pretrained/pretrained.pt"
    ).read_bytes()
    records = read_records(folder / RUNS, FoldRecord)
    assert {record.job.source for record in records} == {PRETRAINED, "without-gel"}
