"""The calibrations that are run by hand: a press on any mesh, the coefficients of an estimate."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from loaded_file import load_file

from gelgap.benchmarks.physics.cases import Solver
from gelgap.benchmarks.physics.references import press_cases
from gelgap.sim.estimate import CAUSES
from gelgap.sim.problem import QUALITIES

SCRIPTS = Path(__file__).parents[1] / "scripts"


def test_a_coarse_mesh_is_solved_and_compared_with_the_table(tmp_path: Path) -> None:
    study = load_file(SCRIPTS / "calibrate_mesh.py")
    sizes, cases = {"draft": QUALITIES["draft"].disc}, [press_cases()["nh49_no_slip"]]
    errors = study.press_on(sizes, cases, Solver(1, tmp_path)).iloc[0]
    assert errors["unconverged"] == 0
    assert len(errors["fz_percent"]) == 5
    assert np.abs(errors["fz_percent"]).max() < 6
    assert errors["peak µm"] > 20


def test_coefficients_of_the_estimate_give_the_variance_that_errors_were_drawn_with() -> None:
    study = load_file(SCRIPTS / "calibrate_estimate.py")
    rng = np.random.default_rng(0)
    causes = rng.uniform(0.0, 1.0, (4000, len(CAUSES)))
    variance = 1e-4 + 4e-4 * causes[:, 1] ** 2
    causes[:, 0] = 1.0
    rows = pd.DataFrame(causes, columns=list(CAUSES)).assign(Fz=rng.normal(0.0, np.sqrt(variance)))
    found = np.array(study.coefficients(rows, "Fz"))
    assert found[:2] == pytest.approx([1e-4, 4e-4], rel=0.15)
    assert found[2:].max() < 3e-5
    estimate = np.sqrt(causes**2 @ found)
    assert (np.abs(rows["Fz"]) < 2 * estimate).mean() == pytest.approx(0.95, abs=0.002)
