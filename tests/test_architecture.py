"""The arrows between the rooms point one way, no modules import each other in a circle, and no file is too long."""

import ast
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).parents[1]
ALLOWED = {
    "assets": set(),
    "sim": {"assets"},
    "render": {"assets"},
    "domains": {"assets", "sim", "render"},
    "view": {"assets", "sim", "render", "domains"},
    "adapt": {"assets", "domains"},
    "benchmarks": {"assets", "sim", "render", "domains", "view", "adapt"},
    "cli": {"assets", "sim", "render", "domains", "view", "adapt", "benchmarks"},
}
CODE = (*ALLOWED, "tests", "examples", "scripts")
MOST_LINES = 600
READS_PICKLES = "benchmarks/real/published_sets.py"
"""Its Unpickler resolves no name to anything of NumPy or Python; `test_published_sets.py` tries hostile ones."""


def sources(folder: str) -> list[Path]:
    found = sorted((ROOT / folder).rglob("*.py"))
    assert found
    return found


def module_name(source: Path) -> str:
    parts = source.relative_to(ROOT).with_suffix("").parts
    return ".".join(("gelgap", *parts)).removesuffix(".__init__")


def imported_names(source: Path, *, at_run_time: bool = False) -> set[str]:
    """Return the dotted names of what a file imports, also inside functions.

    `from a.b import c` gives `a.b` and `a.b.c`. At run time, what stands below `if TYPE_CHECKING` is left out.
    """
    tree = ast.parse(source.read_text(encoding="utf-8"))
    names: set[str] = set()
    for node in _runtime_nodes(tree) if at_run_time else ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{source} imports relatively"
            names.add(node.module)
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return names


def _runtime_nodes(node: ast.AST) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and getattr(child.test, "id", None) == "TYPE_CHECKING":
            continue
        yield child
        yield from _runtime_nodes(child)


@pytest.mark.parametrize("room", ALLOWED)
def test_a_room_imports_only_the_rooms_below_it(room: str) -> None:
    for source in sources(room):
        rooms = {
            name.split(".")[1] for name in imported_names(source) if name.startswith("gelgap.")
        } & ALLOWED.keys()
        assert rooms - {room} <= ALLOWED[room], source


@pytest.mark.parametrize("folder", CODE)
def test_nothing_imports_a_room_by_its_bare_name(folder: str) -> None:
    for source in (ROOT / folder).rglob("*.py"):
        tops = {name.split(".")[0] for name in imported_names(source)}
        assert not tops & set(ALLOWED), source


@pytest.mark.parametrize("room", ALLOWED)
def test_modules_of_a_room_do_not_import_each_other_in_a_circle(room: str) -> None:
    modules = {module_name(source): source for source in sources(room)}
    numbers = {name: number for number, name in enumerate(modules)}
    matrix = np.zeros((len(modules), len(modules)), dtype=bool)
    for name, source in modules.items():
        # A name in a package is the package's module of that name, if there is one.
        for other in imported_names(source, at_run_time=True) & modules.keys():
            is_package = modules[other].name == "__init__.py"
            matrix[numbers[name], numbers[other]] = not is_package
    _, labels = connected_components(csr_array(matrix), connection="strong")
    members = defaultdict(list)
    for name, label in zip(modules, labels, strict=True):
        members[label].append(name)
    circles = [circle for circle in members.values() if len(circle) > 1]
    assert circles == []


@pytest.mark.parametrize("room", ["sim", "render", "domains", "view", "adapt"])
def test_a_room_does_not_enter_through_its_own_face(room: str) -> None:
    face = {f"gelgap.{room}.{name}" for name in import_module(f"gelgap.{room}").__all__}
    modules = {module_name(source) for source in sources(room)}
    offenders = [str(source) for source in sources(room) if imported_names(source) & (face - modules)]
    assert offenders == []


def test_no_file_is_longer_than_a_reader_can_hold() -> None:
    lengths = {
        str(source.relative_to(ROOT)): len(source.read_text(encoding="utf-8").splitlines())
        for folder in CODE
        for source in (ROOT / folder).rglob("*.py")
    }
    assert {name: lines for name, lines in lengths.items() if lines > MOST_LINES} == {}


@pytest.mark.parametrize("folder", [*ALLOWED, "examples", "scripts"])
def test_nothing_pickles_files(folder: str) -> None:
    """A pickle runs whatever its writer put into it; files are read as arrays, JSON, TOML or Parquet."""
    others = (source for source in sources(folder) if source != ROOT / READS_PICKLES)
    offenders = [f"{source}:{line}" for source in others for line in _pickling_lines(source)]
    assert offenders == []


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
