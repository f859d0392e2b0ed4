"""What each room offers is there, described in code, and listed in docs/api.md."""

import ast
import inspect
import re
import tomllib
from importlib import import_module
from pathlib import Path
from types import FunctionType

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("sim", "render", "data", "domains", "view", "adapt")


def names_in_stub(room: str) -> list[str]:
    """Return the names that a room's `__init__.pyi` re-exports, in its order."""
    tree = ast.parse((ROOT / room / "__init__.pyi").read_text(encoding="utf-8"))
    return [alias.asname or alias.name for node in tree.body for alias in node.names]


def names_in_guide(room: str) -> dict[str, str]:
    """Return the names that docs/api.md lists for a room, with what it says about each."""
    guide = (ROOT / "docs/api.md").read_text(encoding="utf-8")
    (section,) = re.findall(rf"^## gelgap\.{room}$(.*?)(?=^## |\Z)", guide, re.MULTILINE | re.DOTALL)
    rows = re.findall(r"^\| `(\w+)` \| (.*) \|$", section, re.MULTILINE)
    assert len(rows) == len(dict(rows)), "a name is listed twice"
    return dict(rows)


def test_every_room_that_installs_says_that_it_is_typed() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    assert [
        room for room in settings["package-dir"].values() if not (ROOT / room / "py.typed").is_file()
    ] == []
    assert "py.typed" in settings["package-data"]["*"]
    # A package that is not listed is missing from a wheel, and in an editable install.
    folders = {
        path.parent
        for room in settings["package-dir"].values()
        for path in (ROOT / room).rglob("__init__.py")
    }
    packages = {".".join(("gelgap", *folder.relative_to(ROOT).parts)) for folder in folders}
    assert set(settings["packages"]) == packages


def test_names_of_stub_guide_and_module_are_the_same_and_described() -> None:
    for room in ROOMS:
        module, listed, rows = import_module(f"gelgap.{room}"), names_in_stub(room), names_in_guide(room)
        assert len(listed) == len(set(listed))
        assert set(module.__all__) == set(listed) == rows.keys()
        assert [name for name in listed if not is_described(getattr(module, name))] == []
        assert [name for name, what in rows.items() if not what.strip()] == []


@pytest.mark.parametrize(("room", "name"), [("domains", "open_domain"), ("render", "detect_markers")])
def test_a_name_that_moved_says_where_it_is(room: str, name: str) -> None:
    with pytest.raises(ImportError, match=rf"gelgap.{room}.{name} is gelgap.data.{name} since gelgap 0.4.0"):
        getattr(import_module(f"gelgap.{room}"), name)


def is_described(thing: object) -> bool:
    """Whether a class or function has a docstring of its own; other values need none."""
    if not (inspect.isclass(thing) or inspect.isfunction(thing)):
        return True
    text = vars(thing).get("__doc__") if inspect.isclass(thing) else thing.__doc__
    return bool(text) and not text.startswith(f"{thing.__name__}(")


def test_what_is_public_says_its_types() -> None:
    things = [
        getattr(import_module(f"gelgap.{room}"), name) for room in ROOMS for name in names_in_stub(room)
    ]
    functions = [function for thing in things for function in public_functions(thing)]
    assert functions
    assert [function.__qualname__ for function in functions if not is_annotated(function)] == []


def public_functions(thing: object) -> list[FunctionType]:
    """Return a function, or the public methods that a class itself defines."""
    members = (
        [thing]
        if not inspect.isclass(thing)
        else [value for name, value in vars(thing).items() if not name.startswith("_")]
    )
    plain = [getattr(member, "__func__", getattr(member, "fget", member)) for member in members]
    return [
        member for member in plain if inspect.isfunction(member) and member.__module__.startswith("gelgap.")
    ]


def is_annotated(function: FunctionType) -> bool:
    """Whether a function's result and all its parameters but self and cls have types."""
    parameters = inspect.signature(function).parameters.keys() - {"self", "cls"}
    return parameters | {"return"} <= function.__annotations__.keys()
