"""Draw the rooms and what they import, from the code, as docs/pictures/rooms.svg.

python scripts/draw_rooms.py
"""

import ast
import re
import sys
import textwrap
import tomllib
from graphlib import TopologicalSorter
from html import escape
from pathlib import Path

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs/pictures/rooms.svg"

WIDTH_PX, ROW_PX = 860, 128
BOX_PX = (226, 70)
SIDE_PX, TOP_PX = 20, 16
# Rooms that reach neither MuJoCo nor the renderer are tinted.
MAKERS = {"sim", "render"}
TINT, PLAIN = "#dcebf7", "#ffffff"


def room_folders() -> dict[str, Path]:
    """Return the folder of each room, by its name."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    return {
        room.removeprefix("gelgap."): ROOT / folder
        for room, folder in settings["package-dir"].items()
        if room.startswith("gelgap.")
    }


def read_arrows(folders: dict[str, Path]) -> dict[str, set[str]]:
    """Return which other rooms each room imports, also inside functions, for types, and by a name in a string."""
    arrows = {}
    for room, folder in folders.items():
        imported = set()
        for source in sorted(folder.rglob("*.py")):
            for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    imported |= {alias.name for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module == "gelgap":
                    imported |= {f"gelgap.{alias.name}" for alias in node.names}
                elif isinstance(node, ast.ImportFrom):
                    imported.add(node.module or "")
                elif isinstance(node, ast.Call) and called_name(node) in ("resolve_name", "import_module"):
                    imported |= {text.value for text in ast.walk(node) if isinstance(text, ast.Constant)}
        others = {name.split(".")[1] for name in imported if str(name).startswith("gelgap.")}
        arrows[room] = others & folders.keys() - {room}
    return arrows


def called_name(call: ast.Call) -> str:
    """Return the last name of what is called: `resolve_name` of `pkgutil.resolve_name(…)`."""
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


def reached(room: str, arrows: dict[str, set[str]]) -> set[str]:
    """Return all rooms that one comes to from a room along the arrows."""
    return arrows[room].union(*(reached(below, arrows) for below in arrows[room]))


def without_shortcuts(arrows: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the arrows that do not follow from others."""
    return {
        room: below - set().union(*(reached(other, arrows) for other in below))
        for room, below in arrows.items()
    }


def rows_from_below(arrows: dict[str, set[str]]) -> list[list[str]]:
    """Return the rooms in rows: each as low as its imports allow, and beside the rooms that it imports."""
    level: dict[str, int] = {}
    for room in TopologicalSorter(arrows).static_order():
        level[room] = 1 + max((level[below] for below in arrows[room]), default=-1)
    rows: list[list[str]] = []
    place: dict[str, float] = {}
    for number in range(max(level.values()) + 1):
        middle = {
            room: sum(place[below] for below in arrows[room]) / max(1, len(arrows[room]))
            for room in level
            if level[room] == number
        }
        row = sorted(middle, key=lambda room: (round(middle[room], 6), room))
        place |= {room: (index + 0.5) / len(row) for index, room in enumerate(row)}
        rows.append(row)
    return rows


def caption(folder: Path) -> list[str]:
    """Return what a room is, in lines: its docstring up to the first colon or comma."""
    text = ast.get_docstring(ast.parse((folder / "__init__.py").read_text(encoding="utf-8")))
    return textwrap.wrap(re.split(r"[:.,]", text)[0], 30)


def draw(arrows: dict[str, set[str]], captions: dict[str, list[str]]) -> str:
    """Return the drawing: who imports stands above what it imports."""
    shown = without_shortcuts(arrows)
    rows = rows_from_below(shown)[::-1]
    width, height = BOX_PX
    middle_px = {}
    for number, row in enumerate(rows):
        for index, room in enumerate(row):
            x = SIDE_PX + (index + 0.5) * (WIDTH_PX - 2 * SIDE_PX) / len(row)
            middle_px[room] = (x, TOP_PX + number * ROW_PX + height / 2)
    tall = TOP_PX + (len(rows) - 1) * ROW_PX + height + 44
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH_PX} {tall}" font-family="sans-serif">',
        '<marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="8" markerHeight="8" orient="auto">'
        '<path d="M0 1 L9 5 L0 9 z" fill="#555"/></marker>',
        f'<rect width="{WIDTH_PX}" height="{tall}" fill="white"/>',
    ]
    for room in sorted(shown):
        x, y = middle_px[room]
        for below in sorted(shown[room]):
            x2, y2 = middle_px[below]
            # Arrows of one room leave and enter its box side by side.
            leave, enter = (x2 - x) * 0.18, (x - x2) * 0.18
            parts.append(
                f'<line x1="{x + leave:.0f}" y1="{y + height / 2:.0f}" x2="{x2 + enter:.0f}" '
                f'y2="{y2 - height / 2 - 2:.0f}" stroke="#555" stroke-width="1.4" marker-end="url(#head)"/>'
            )
    for room, (x, y) in sorted(middle_px.items()):
        fill = PLAIN if MAKERS & ({room} | reached(room, arrows)) else TINT
        parts.append(
            f'<rect x="{x - width / 2:.0f}" y="{y - height / 2:.0f}" width="{width}" height="{height}" rx="8" '
            f'fill="{fill}" stroke="#333"/>'
        )
        lines = captions[room]
        first = y - 9 * len(lines)
        parts.append(
            f'<text x="{x:.0f}" y="{first + 5:.0f}" text-anchor="middle" font-size="17" '
            f'font-weight="bold">{escape(room)}</text>'
        )
        parts += [
            f'<text x="{x:.0f}" y="{first + 24 + 16 * number:.0f}" text-anchor="middle" font-size="12.5" '
            f'fill="#333">{escape(line)}</text>'
            for number, line in enumerate(lines)
        ]
    parts.append(
        f'<text x="{SIDE_PX}" y="{tall - 14}" font-size="12.5" fill="#333">An arrow: imports. Left out: arrows that '
        "follow from others. Tinted: needs neither MuJoCo nor the renderer.</text>"
    )
    return "\n".join([*parts, "</svg>", ""])


def make() -> str:
    """Return the drawing of the code as it stands."""
    folders = room_folders()
    return draw(read_arrows(folders), {room: caption(folder) for room, folder in folders.items()})


def main() -> int:
    PICTURE.write_text(make(), encoding="utf-8")
    for room, below in read_arrows(room_folders()).items():
        print(f"{room}: {', '.join(sorted(below)) or 'nothing'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
