"""The drawing of the rooms in docs/architecture.md is of today's code."""

from pathlib import Path

import pytest
from loaded_file import load_file

SCRIPT = load_file(Path(__file__).parents[1] / "scripts/draw_rooms.py")


def test_the_drawing_shows_the_rooms_and_arrows_of_todays_code() -> None:
    committed = SCRIPT.PICTURE.read_text(encoding="utf-8")
    assert committed == SCRIPT.make(), "run: python scripts/draw_rooms.py"


def test_arrows_are_read_from_imports_of_every_kind(tmp_path: Path) -> None:
    (tmp_path / "attic").mkdir()
    (tmp_path / "attic/a.py").write_text("def late():\n    from gelgap.cellar.wine import red\n")
    (tmp_path / "attic/b.py").write_text(
        "import gelgap.stairs\nfrom gelgap import attic, hall\nimport numpy\n"
    )
    (tmp_path / "attic/c.py").write_text(
        "def named(door):\n    return resolve_name(f'gelgap.garden.{door}')\n"
    )
    folders = {room: tmp_path / room for room in ("attic", "hall", "stairs", "cellar", "garden")}
    assert SCRIPT.read_arrows(folders)["attic"] == {"cellar", "garden", "hall", "stairs"}


@pytest.fixture
def house() -> dict[str, set[str]]:
    return {"attic": {"hall", "cellar", "stairs"}, "hall": {"cellar"}, "stairs": {"cellar"}, "cellar": set()}


def test_arrows_that_follow_from_others_are_left_out(house: dict[str, set[str]]) -> None:
    assert SCRIPT.without_shortcuts(house) == house | {"attic": {"hall", "stairs"}}


def test_a_room_stands_above_all_that_it_imports(house: dict[str, set[str]]) -> None:
    assert SCRIPT.rows_from_below(house) == [["cellar"], ["hall", "stairs"], ["attic"]]
