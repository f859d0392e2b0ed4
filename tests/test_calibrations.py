"""The calibrations that are run by hand: a study of meshes solves a table's press on any mesh, and judges it."""

from pathlib import Path

import numpy as np
from loaded_file import load_file

from gelgap.benchmarks.fem.spheres import Drag
from gelgap.benchmarks.physics.cases import Solver
from gelgap.benchmarks.physics.references import press_cases
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


def test_drags_are_tabled_on_a_coarse_and_a_fine_mesh() -> None:
    study = load_file(SCRIPTS / "drag_table.py")
    assert all(coarse > fine for (coarse, _), (fine, _) in study.MESHES.values())
    rows = study.drag_rows(Drag(depth_mm=0.3, element_mm=0.6, sectors=8))["rows"]
    assert [row[0] for row in rows] == [f"{travel:.9g}" for travel in study.TRAVELS_MM]
    assert float(rows[-1][1]) > 0 > float(rows[-1][2])
