"""Columns are offered and described as they are; a frame's noise is its own and repeats itself."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from gelgap.data.formats.optional_columns import OptionalColumn
from gelgap.data.formats.shards import IMAGE, LABELS, OPTIONAL
from gelgap.domains import DomainRecipe, make_recipes
from gelgap.domains.generation.shard import picture_cells
from gelgap.sim import MembraneState
from gelgap.sim.membrane import grid_axes

GUIDE = Path(__file__).parents[2] / "docs" / "data.md"


def test_every_optional_column_is_made() -> None:
    assert get_args(OptionalColumn) == tuple(OPTIONAL)


def test_the_guide_lists_every_column_with_its_unit() -> None:
    _, table = GUIDE.read_text(encoding="utf-8").split("\n| `frame_id` |")
    table = ("| `frame_id` |" + table).split("\n\n")[0]
    rows = [line.split("|") for line in table.splitlines()]
    for column in (*LABELS, IMAGE, *(OPTIONAL[name][0] for name in OPTIONAL)):
        (units,) = [row[2].strip() for row in rows if f"`{column.name}`" in row[1]]
        assert column.unit in units.split(", ") if column.unit else not units, column.name


def membrane(depth_mm: float) -> MembraneState:
    """Return a flat membrane that is pressed in as a whole."""
    x_mm, y_mm = grid_axes()
    displacement_mm = np.zeros((len(y_mm), len(x_mm), 3), np.float32)
    displacement_mm[..., 2] = -depth_mm
    touches = np.zeros(displacement_mm.shape[:2], bool)
    return MembraneState(x_mm, y_mm, displacement_mm, touches, np.zeros(3), 0.0)


def test_a_height_that_no_map_can_hold_is_no_other_height() -> None:
    settings = {"size_px": (64, 48), "render_quality": "draft", "columns": ("height_map",)}
    (recipe,) = make_recipes(["mb0i0"], "smoke", **settings)
    picture_cells([recipe], 0, membrane(6.0))
    with pytest.raises(ValueError, match=r"heights are 7\.00 to 7"):
        picture_cells([recipe], 0, membrane(7.0))


def test_noise_differs_from_frame_to_frame_and_from_seed_to_seed_and_repeats_itself() -> None:
    flat = membrane(0.0)
    (recipe,) = make_recipes(["mb0i0"], "smoke", size_px=(64, 48), render_quality="draft")

    def png(of: DomainRecipe, frame: int) -> bytes:
        (cells,) = picture_cells([of], frame, flat)
        return cells["image"]["bytes"]

    assert png(recipe, 7) == png(recipe, 7)
    assert png(recipe, 7) != png(recipe, 8)
    assert png(recipe, 7) != png(recipe.model_copy(update={"seed": 1}), 7)
