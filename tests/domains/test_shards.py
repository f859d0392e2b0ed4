from pathlib import Path
from typing import get_args

import pytest

from gelgap.cli.generate import OptionalColumn
from gelgap.domains.formats import shards
from gelgap.domains.formats.shards import IMAGE, LABELS, OPTIONAL, Column

GUIDE = Path(__file__).parents[2] / "docs" / "data.md"


def test_the_command_offers_every_optional_column():
    assert get_args(OptionalColumn) == get_args(shards.OptionalColumn) == tuple(OPTIONAL)


@pytest.mark.parametrize(
    "column", [*LABELS, IMAGE, *(OPTIONAL[name][0] for name in OPTIONAL)], ids=lambda column: column.name
)
def test_the_guide_lists_every_column_with_its_unit(column: Column):
    _, table = GUIDE.read_text(encoding="utf-8").split("\n| `frame_id` |")
    table = ("| `frame_id` |" + table).split("\n\n")[0]
    rows = [line.split("|") for line in table.splitlines()]
    (units,) = [row[2] for row in rows if f"`{column.name}`" in row[1]]
    assert column.unit in units.strip().split(", ") if column.unit else not units.strip()
