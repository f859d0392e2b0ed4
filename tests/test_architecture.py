"""The arrows between the rooms point one way, no modules import each other in a circle, and the doors stay few."""

import ast
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from gelgap.cli.main import COMMANDS

ROOT = Path(__file__).parents[1]
ALLOWED = {
    "assets": set(),
    "data": {"assets"},
    "sim": {"assets"},
    "render": {"assets"},
    "domains": {"assets", "data", "sim", "render"},
    "calibrate": {"assets", "data", "sim", "render"},
    "view": {"assets", "data", "sim", "render", "domains", "calibrate"},
    "adapt": {"assets", "data"},
    "benchmarks": {"assets", "data", "sim", "render", "domains", "calibrate", "adapt"},
    "cli": {"assets", "data", "sim", "render", "domains", "calibrate", "view", "adapt", "benchmarks"},
}
CODE = (*ALLOWED, "tests", "examples", "scripts")
# One person is to hold the house in the head: what counts first is its doors, and what lies behind one file. Their
# ceilings fall from release to release.
MOST_PUBLIC_NAMES = 108
MOST_ARGUMENTS = 120
MOST_NAMES_OF_ARGUMENTS = 74
MOST_LINES_OF_A_FILE = 600
LEAST_LINES_OF_A_FILE = 60
_PHYSICS_AND_LIGHT = {"sim", "render", "domains", "calibrate", "benchmarks", "cli", "view"}
CLOSURES = {
    "adapt.methods.mmd": (10, 2_000, _PHYSICS_AND_LIGHT),
    "adapt.trainer": (35, 8_000, _PHYSICS_AND_LIGHT),
    "adapt.data": (20, 4_500, _PHYSICS_AND_LIGHT),
    "sim.plan": (38, 9_100, {"render", "data", "domains", "adapt", "view", "cli"}),
    "render.renderer": (22, 4_200, {"sim", "data", "domains", "adapt", "view", "cli"}),
    "cli.press": (50, 11_500, {"adapt", "benchmarks"}),
    "cli.calibrate": (50, 12_500, {"adapt", "benchmarks"}),
    "cli.predict": (30, 6_500, {"sim", "render", "domains", "calibrate", "benchmarks"}),
    "cli.generate": (75, 17_500, {"adapt", "benchmarks"}),
}
"""Who changes one of these files must know at most so many files and lines, and nothing of some rooms."""
STAND_ALONE = ("cli/", "adapt/methods/")
"""Where a file may be as short as its command or method is."""
READS_PICKLES = "data/formats/published_sets.py"
"""Its Unpickler resolves no name to anything of NumPy or Python; `test_published_sets.py` tries hostile ones."""


def sources(folder: str) -> list[Path]:
    found = sorted((ROOT / folder).rglob("*.py"))
    assert found
    return found


def by_room() -> list[tuple[str, Path]]:
    return [(room, source) for room in ALLOWED for source in sources(room)]


def module_name(source: Path) -> str:
    parts = source.relative_to(ROOT).with_suffix("").parts
    return ".".join(("gelgap", *parts)).removesuffix(".__init__")


@cache
def imported_names(source: Path) -> frozenset[str]:
    """Return the dotted names of what a file imports, also inside functions and for types.

    `from a.b import c` gives `a.b` and `a.b.c`.
    """
    names: set[str] = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{source} imports relatively"
            names.add(node.module)
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return frozenset(names)


def test_a_room_imports_only_the_rooms_below_it() -> None:
    for room, source in by_room():
        rooms = {
            name.split(".")[1] for name in imported_names(source) if name.startswith("gelgap.")
        } & ALLOWED.keys()
        assert rooms - {room} <= ALLOWED[room], source


def test_nothing_imports_a_room_by_its_bare_name() -> None:
    for source in (source for folder in CODE for source in sources(folder)):
        tops = {name.split(".")[0] for name in imported_names(source)}
        assert not tops & set(ALLOWED), source


def test_modules_do_not_import_each_other_in_a_circle() -> None:
    """Imports for types count too: who reads the one file has to read the other."""
    modules = {module_name(source): source for _, source in by_room()}
    numbers = {name: number for number, name in enumerate(modules)}
    matrix = np.zeros((len(modules), len(modules)), dtype=bool)
    for name, source in modules.items():
        # A name in a package is the package's module of that name, if there is one.
        for other in imported_names(source) & modules.keys():
            is_package = modules[other].name == "__init__.py"
            matrix[numbers[name], numbers[other]] = not is_package
    _, labels = connected_components(csr_array(matrix), connection="strong")
    members = defaultdict(list)
    for name, label in zip(modules, labels, strict=True):
        members[label].append(name)
    circles = [circle for circle in members.values() if len(circle) > 1]
    assert circles == []


def test_a_room_does_not_enter_through_its_own_face() -> None:
    offenders = []
    for room in ("sim", "render", "data", "domains", "view", "adapt"):
        face = {f"gelgap.{room}.{name}" for name in import_module(f"gelgap.{room}").__all__}
        modules = {module_name(source) for source in sources(room)}
        offenders += [str(source) for source in sources(room) if imported_names(source) & (face - modules)]
    assert offenders == []


def line_count(source: Path) -> int:
    return len(source.read_text(encoding="utf-8").splitlines())


def test_public_names_are_few() -> None:
    names = [name for room in ALLOWED for name in getattr(import_module(f"gelgap.{room}"), "__all__", ())]
    assert len(names) <= MOST_PUBLIC_NAMES


def test_options_and_arguments_of_the_command_line_are_few() -> None:
    typed = [name for command in COMMANDS.values() for name in option_names(command)]
    assert len(typed) <= MOST_ARGUMENTS
    assert len(set(typed)) <= MOST_NAMES_OF_ARGUMENTS


def option_names(options: type) -> Iterator[str]:
    """Yield what can be typed behind a command, also of groups of options."""
    hints = get_type_hints(options)
    for field in fields(options):
        hint = hints[field.name]
        yield from option_names(hint) if is_dataclass(hint) else [field.name]


@pytest.mark.parametrize("name", CLOSURES)
def test_what_one_must_know_for_one_file_is_little(name: str) -> None:
    most_files, most_lines, forbidden = CLOSURES[name]
    known = closure(f"gelgap.{name}")
    assert {module.split(".")[1] for module in known} & forbidden == set()
    assert len(known) <= most_files
    assert sum(map(line_count, known.values())) <= most_lines


def closure(start: str) -> dict[str, Path]:
    """Return the modules that one reaches by imports, also by those inside functions, and their files.

    A name of a room's face leads to the module that defines it.
    """
    modules = {
        module_name(source): source
        for _, source in by_room()
        if source.name != "__init__.py"
        or not (source.with_suffix(".pyi").exists() or line_count(source) == 1)
    }
    behind_faces = {
        f"gelgap.{room}.{name}": f"gelgap.{room}.{module}"
        for room in ALLOWED
        for face in (ROOT / room).glob("__init__.pyi")
        for module, name in re.findall(r"from \.([\w.]+) import (\w+)", face.read_text("utf-8"))
    }
    reached: dict[str, Path] = {}
    waiting = [start]
    while waiting:
        name = waiting.pop()
        if name in reached:
            continue
        reached[name] = modules[name]
        names = {behind_faces.get(other, other) for other in imported_names(modules[name])}
        waiting += names & modules.keys()
    return reached


def test_no_file_is_longer_than_a_reader_can_hold() -> None:
    lengths = {source: line_count(source) for folder in CODE for source in sources(folder)}
    assert {str(source): lines for source, lines in lengths.items() if lines > MOST_LINES_OF_A_FILE} == {}


def test_a_short_module_has_more_than_one_importer_or_is_part_of_it() -> None:
    """What a room's face (`__init__.pyi`) names is for everybody; a benchmark that the command names is for it."""
    importers = defaultdict(set)
    for _, source in by_room():
        for name in imported_names(source):
            importers[name].add(source)
    offenders = []
    for room, source in by_room():
        name = module_name(source)
        public = any(f"from {name} import" in face for face in faces(room))
        short = line_count(source) < LEAST_LINES_OF_A_FILE and not source.name.startswith("__")
        stands_alone = str(source.relative_to(ROOT)).startswith(STAND_ALONE)
        if short and not public and not stands_alone and len(importers[name]) == 1:
            offenders.append(name)
    assert offenders == []


def faces(room: str) -> list[str]:
    """Return the text of a room's face, if it has one, with its imports in full."""
    return [
        re.sub(r"from \.([\w.]+)", rf"from gelgap.{room}.\1", face.read_text("utf-8"))
        for face in (ROOT / room).glob("__init__.pyi")
    ]


def test_what_the_package_imports_is_declared() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    declared = [*project["dependencies"], *(one for extra in extras for one in extra)]
    declared_names = {re.split(r"[\[<>=!~]", one)[0].lower().replace("_", "-") for one in declared}
    assert len(project["dependencies"]) == len(
        {re.split(r"[<>=]", one)[0] for one in project["dependencies"]}
    )
    distributions = packages_distributions()
    imported = {
        name.split(".")[0] for room in ALLOWED for source in sources(room) for name in imported_names(source)
    }
    undeclared = {
        top
        for top in imported - {"gelgap"} - set(sys.stdlib_module_names)
        if top in distributions
        and not {name.lower().replace("_", "-") for name in distributions[top]} & declared_names
    }
    assert undeclared == set()


def test_nothing_pickles_files() -> None:
    """A pickle runs whatever its writer put into it; files are read as arrays, JSON, TOML or Parquet."""
    every = {source for folder in (*ALLOWED, "examples", "scripts") for source in sources(folder)}
    others = sorted(every - {ROOT / READS_PICKLES})
    assert [f"{source}:{line}" for source in others for line in _pickling_lines(source)] == []


def _pickling_lines(source: Path) -> Iterator[int]:
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules = {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            modules = {node.module}
        else:
            modules = set()
        allowed = isinstance(node, ast.keyword) and node.arg in ("allow_pickle", "weights_only")
        if modules & {"pickle", "cloudpickle", "dill", "shelve", "marshal", "joblib"}:
            yield node.lineno
        elif allowed and getattr(node.value, "value", None) is not (node.arg == "weights_only"):
            yield node.value.lineno


def test_help_does_not_import_heavy_packages() -> None:
    code = (
        "import sys\n"
        "from gelgap.cli.main import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'torch', 'mujoco', 'colour', 'matplotlib', 'dask', 'distributed', 'pyrender', 'cv2', 'sklearn',"
        " 'scipy', 'numba', 'pyarrow', 'pydantic', 'numpy', 'jinja2', 'viser', 'trimesh'}\n"
        "print(sorted(heavy & set(sys.modules)))\n"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert output.splitlines()[-1] == "[]"
