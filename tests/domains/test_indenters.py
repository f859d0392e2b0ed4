"""Domains of several indenters: frames, columns and splits."""

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest

from gelgap.data import open_domain, split_frames
from gelgap.data.formats.shards import OPTIONAL
from gelgap.domains import DomainRecipe, generate_recipes, make_recipes, preset_recipes
from gelgap.domains.generation.columns import LABEL_MAKERS
from gelgap.domains.generation.estimate import estimate
from gelgap.domains.generation.plan import plan_generation
from gelgap.render.sensor import BallResidual
from gelgap.sim import Cone, PosePath, Sphere

PATH = PosePath.from_trajectories("two", [{"waypoints_mm": [(0.0, 0.0, 0.2), (0.0, 0.1, 0.2)]}])
BODIES = {"indenter": Sphere(diameter_mm=4.0), "further_indenters": (Sphere(diameter_mm=6.0), Sphere())}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("indenters")
    columns = ("indenter", "torque", "traction")
    settings = {"quality": "draft", "size_px": (64, 48), "columns": columns, "render_quality": "draft"}
    generate_recipes(make_recipes(["mb0i0"], PATH, **BODIES, **settings), out, scheduler="synchronous")
    return out / "mb0i0"


def test_each_indenter_goes_the_whole_path(folder: Path) -> None:
    frames = open_domain(folder)
    columns = frames.columns
    assert list(columns["indenter"]) == [f"sphere {size} mm" for size in (4, 6, 3) for _ in range(3)]
    assert list(columns["depth_mm"]) == [0.0, 0.2, 0.2] * 3
    assert len(set(columns["trajectory_id"])) == 6
    force_n = columns["fz_n"].reshape(3, 3)[:, 1]
    assert force_n[1] < force_n[0] < force_n[2] < 0


def test_six_axes_and_forces_by_cell_belong_together(folder: Path) -> None:
    table = pq.read_table(next(folder.glob("*.parquet"))).to_pydict()
    force = np.stack([table[f"f{axis}_n"] for axis in "xyz"], axis=1)
    cells = np.array(table["traction_n"]).reshape(9, 24, 32, 3)
    np.testing.assert_allclose(cells.sum(axis=(1, 2)), force, atol=1e-6)
    np.testing.assert_array_equal(open_domain(folder).traction_map_n(4), cells[4])
    # Dragged along y, the force's line passes beside the contact point.
    torque = np.stack([table[f"t{axis}_n_mm"] for axis in "xyz"], axis=1)[2::3]
    assert (torque[:, 0] < 0).all()
    np.testing.assert_allclose(torque[:, 2], 0.0, atol=1e-9)


def test_frames_of_an_indenter_stay_in_one_part(folder: Path) -> None:
    frames = open_domain(folder)
    parts = split_frames(frames, by="indenter", shares=(0.34, 0.33, 0.33))
    assert [len(set(frames.columns["indenter"][part])) for part in parts] == [1, 1, 1]


def test_the_frames_of_every_indenter_are_planned() -> None:
    assert plan_generation(make_recipes(["mb0i0"], PATH, **BODIES)).frames == 9


def test_one_indenter_is_configured_as_before() -> None:
    (recipe,) = make_recipes(["mb0i0"], PATH)
    assert "further_indenters" not in recipe.configuration()
    assert type(recipe)(**recipe.configuration()).key == recipe.key
    (several,) = make_recipes(["mb0i0"], PATH, indenter=Sphere(), further_indenters=(Cone(),))
    assert several.frames == 2 * recipe.frames
    assert type(several)(**several.configuration()).key == several.key
    coefficients = ((0.0, 0.0, 1.0),) * 648
    residual = BallResidual(
        diameter_mm=4.0, least=(0.0, 0.0, 1.0), largest=(1.0, 1.0, 1.2), coefficients=coefficients
    )
    fitted = recipe.sensor.model_copy(update={"marks_off": ((0.1, 0.0, 0.0),) * 4, "ball_residual": residual})
    assert recipe.model_copy(update={"sensor": fitted}).key == recipe.key
    tabled = fitted.model_copy(update={"normal_table": ((1.0, 0.0, 0.0),) * 27})
    assert recipe.model_copy(update={"sensor": tabled}).key == recipe.key
    drawn_by_it = tabled.model_copy(update={"table_share": 0.5})
    assert recipe.model_copy(update={"sensor": drawn_by_it}).key != recipe.key


def indenter_lines(recipes: Sequence[DomainRecipe]) -> list[str]:
    return [line for line in str(estimate(recipes)).splitlines() if line.startswith("indenter")]


def test_the_preset_says_what_each_shape_takes() -> None:
    recipes = preset_recipes("shapes", quality="draft")
    plan = plan_generation(recipes)
    assert plan.frames == 1950
    lines = indenter_lines(recipes)
    assert len(lines) == 5
    # Directions that are not alike are solved one by one.
    sphere, box = (int(lines[k].split(" solves, ")[1].split(" s of")[0]) for k in (0, 3))
    assert 2 * sphere < box


def test_a_data_set_with_indenters_of_its_own_takes_no_others_and_keeps_other_columns() -> None:
    with pytest.raises(ValueError, match=r"'shapes' has indenters of its own.*mb0i0 --path shapes"):
        preset_recipes("shapes", further_indenters=(Sphere(diameter_mm=4.0),))
    (recipe,) = preset_recipes("shapes", columns=("torque",))
    assert {"torque", "indenter"} <= set(recipe.columns)


def test_turns_are_told_with_their_time_and_in_columns() -> None:
    way = {"waypoints_mm": [(0.0, 0.0, 0.2), (0.0, 0.0, 0.2)], "twist_deg": [0.0, 5.0]}
    path = PosePath.from_trajectories("twist", [way])
    (recipe,) = make_recipes(["mb0i0"], path, quality="draft", columns=("turn",))
    (note,) = indenter_lines((recipe,))
    assert "turning: 1 solves" in note
    contact = SimpleNamespace(pose=path.poses[-1])
    assert {column.name: LABEL_MAKERS[column.name](contact) for column in OPTIONAL["turn"]} == {
        "roll_x_deg": 0.0,
        "roll_y_deg": 0.0,
        "twist_deg": 5.0,
    }
    assert type(recipe)(**recipe.configuration()).key == recipe.key
    (straight,) = make_recipes(["mb0i0"], PATH)
    assert "twist_deg" not in str(straight.configuration())
