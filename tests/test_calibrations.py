"""The calibrations that are run by hand: the stiffness of a mesh, the coefficients of an estimate."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from loaded_file import load_file

from gelgap.benchmarks.physics.references import press_cases
from gelgap.sim.estimate import CAUSES

SCRIPTS = Path(__file__).parents[1] / "scripts"


def test_the_stiffness_of_a_mesh_is_found_from_the_ratios_that_it_leaves() -> None:
    study, (a, b, c) = load_file(SCRIPTS / "calibrate_mesh.py"), (0.02, 4e-4, 0.15)
    presses = [case.down_to(depth_mm) for case in press_cases().values() for depth_mm in (0.2, 0.6, 1.0)]
    cases = [study.on_mesh(case, "draft", "disc") for case in presses]
    ratios = []
    for problem in (case.solve.problem for case in cases):
        excess = (a + b / (1 - 2 * problem.moduli.poisson_ratio)) * (1 - c * np.log(problem.contact_width))
        ratios.append((1 + excess) / (1 + problem.stiffness_excess))
    assert study.stiffness(cases, ratios) == pytest.approx((a, b, c), rel=1e-3)


def test_coefficients_of_the_estimate_give_the_variance_that_errors_were_drawn_with() -> None:
    study = load_file(SCRIPTS / "calibrate_estimate.py")
    rng = np.random.default_rng(0)
    causes = rng.uniform(0.0, 1.0, (4000, len(CAUSES)))
    variance = 1e-4 + 4e-4 * causes[:, 1] ** 2
    causes[:, 0] = 1.0
    rows = pd.DataFrame(causes, columns=list(CAUSES)).assign(
        quality="draft", Fz=rng.normal(0.0, np.sqrt(variance))
    )
    found = np.array(study.coefficients(rows, "Fz"))
    assert found[:2] == pytest.approx([1e-4, 4e-4], rel=0.15)
    assert found[2:].max() < 3e-5
    estimate = np.sqrt(causes**2 @ found)
    assert (np.abs(rows["Fz"]) < 2 * estimate).mean() == pytest.approx(0.95, abs=0.002)
