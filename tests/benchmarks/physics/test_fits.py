"""Each fitted number of `assets/fitted` comes out again, roughly, where its script fits it to fewer solves."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from gelgap.assets import asset_path
from gelgap.assets.toml_file import read_toml
from gelgap.benchmarks.physics import fit_cost, fit_estimate, fit_meshes, fit_moduli
from gelgap.benchmarks.physics.axisymmetric import Press, solve_press
from gelgap.sim.estimate import CAUSES
from gelgap.sim.scene import Moduli, equivalent_moduli

pytestmark = pytest.mark.slow


def _file(name: str) -> dict:
    return read_toml(asset_path("fitted", f"{name}.toml"))


def test_the_axisymmetric_solver_finds_the_forces_of_felupe() -> None:
    table = pd.read_csv(asset_path("reference", "force_depth.csv")).query("case == 'nh48_frictionless'")
    press = Press(poisson_ratio=0.48, friction=0.0, element_mm=0.1)
    states = solve_press(press, tuple(table["depth_mm"]))
    np.testing.assert_allclose([state.force_n for state in states], table["fz_n"], rtol=0.006)


def test_equivalent_moduli_come_out_of_fewer_presses() -> None:
    stable = (0.35, 0.4, 0.44, 0.47, 0.49, 0.497, 0.499)
    *_, table = fit_moduli.fit((0.41, 0.47, 0.49), stable, frictions=(0.0,), element_mm=0.15)
    for row in table.to_dict("records"):
        fitted = equivalent_moduli(Moduli(1.0, row["ν"]))
        assert row["E′/E best"] == pytest.approx(fitted.young_modulus_mpa, abs=0.012)
        assert row["ν′ best"] == pytest.approx(fitted.poisson_ratio, abs=0.006)


def test_the_stiffness_of_a_draft_comes_out_of_fewer_presses() -> None:
    scenes = [
        descent
        for descent in fit_meshes.FITTED
        if descent.friction == 0.0 and descent.poisson_ratio != 0.45 and descent.depths_mm[0] != 0.01
    ]
    fitted, cases = fit_meshes.force_ratios(scenes[:6], "draft", "disc")
    a, b, c = fit_meshes.stiffness(cases, fitted["mean ratio"])
    for case in cases:
        problem = case.solve.problem
        bulk = 1 / (1 - 2 * problem.moduli.poisson_ratio)
        excess = (a + b * bulk) * (1 - c * np.log(problem.contact_width))
        assert excess == pytest.approx(problem.stiffness_excess, abs=0.015)


def test_the_rise_of_the_force_with_poissons_ratio_comes_out_without_friction() -> None:
    rise = fit_meshes.force_rise_per_poisson(frictions=(0.0,))
    assert rise == pytest.approx(_file("meshes")["force_rise_per_poisson"], abs=0.4)


def test_iterations_come_out_of_fewer_solves() -> None:
    """Seconds are the machine's."""
    rows = pd.DataFrame([fit_cost.measure(problem) for problem in fit_cost.problems(("draft",), most=4)])
    file, fitted = _file("cost"), fit_cost.fit(rows)
    found, stated = (
        rows["presses"] * numbers["press_iterations"]
        + rows["drags"] * numbers["drag_iterations"]
        + rows["cells"] * numbers["cell_iterations"]
        for numbers in (fitted, file)
    )
    assert ((found / stated).between(1 / 1.6, 1.6)).all()


def test_estimates_come_out_of_fewer_scenes(tmp_path: Path) -> None:
    """Of so few scenes a standard deviation is known to a factor."""
    presses = [n for n in range(72, 90) if fit_estimate.has_own_truth(fit_estimate.random_case(n))][:8]
    rows = fit_estimate.random_errors(presses, ("draft",), tmp_path)
    rows = rows[rows["usable"]]
    causes_squared = rows[list(CAUSES)].to_numpy() ** 2
    for error, stated in zip(fit_estimate.ERRORS, _file("estimate")["variance_per_cause"], strict=True):
        if error == "shear":  # presses have none
            continue
        fitted = fit_estimate.variance_per_cause(rows, error)
        ratio = np.sqrt((causes_squared @ fitted) / (causes_squared @ stated))
        assert 0.25 < np.median(ratio) < 4
