"""Wrong values for every option of every command, made from the command line's own definition."""

import contextlib
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from importlib import import_module
from pathlib import Path
from types import FunctionType, NoneType, SimpleNamespace
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import cv2
import numpy as np
import pytest
import tyro

from gelgap.adapt import Profile
from gelgap.adapt.trainer import untrained
from gelgap.cli.main import COMMANDS, main
from gelgap.cli.options import Check, output_file, output_folder
from gelgap.domains import open_domain
from gelgap.sim import MembraneState

HUGE = "9" * 400
LONG = "x" * 5000
A_FOLDER, A_FILE = "a-folder", "a-file.txt"
NO_FOLDER_HERE = f"{A_FILE}/below"

RIGHT: dict[str, dict[str, list[str]]] = {
    "demo": {"--out": ["demo"]},
    "press": {},
    "render": {"state": ["state.npz"], "--output": ["picture.png"]},
    "generate": {"domains": ["mb0i0"], "--out": ["data"]},
    "inspect": {"folder": ["real"]},
    "export": {"folder": ["real"], "--out": ["exported"]},
    "convert": {"folder": ["real"], "--layout": ["recordings"], "--out": ["converted"]},
    "calibrate": {
        "presses": ["presses.toml"],
        "--reference": ["real/reference.png"],
        "--sensor": ["digit-like"],
        "--output": ["fitted.toml"],
    },
    "pretrain": {"--out": ["pretrained"], "--quick": []},
    "adapt": {"--source": ["real"], "--target": ["real"], "--out": ["runs"]},
    "finetune": {"checkpoint": ["checkpoint.pt"], "--on": ["real"], "--test": ["real"], "--frames": ["2"]},
    "predict": {
        "model": ["checkpoint.pt"],
        "pictures": ["real/1.png"],
        "--reference": ["real/reference.png"],
    },
    "export-model": {"model": ["checkpoint.pt"], "--out": ["model.onnx"]},
    "report": {"runs": ["finished"]},
    "benchmark": {"subject": ["physics"], "--out": ["results"]},
    "presets": {},
    "cache": {},
    "view": {"--port": ["0"], "--no-browser": []},
}
"""What a command needs besides the option that is tried."""

SHAPES = {
    "--edge-radius-mm": "box",
    "--half-angle-deg": "cone",
    "--tip-radius-mm": "cone",
    "--length-mm": "edge",
    "--size-mm": "box",
    "--diameters-mm": "ellipsoid",
    "--yaw-deg": "box",
    "--tilt-deg": "box",
}
"""Indenters that have a size."""

BESIDE: dict[tuple[str, str], dict[str, list[str] | None]] = {
    **{
        (command, size): {"--indenter": [shape]}
        for command in ("press", "generate")
        for size, shape in SHAPES.items()
    },
    ("generate", "--preset"): {"domains": []},
    ("generate", "--sweep"): {"domains": []},
    ("generate", "--recipe"): {"domains": []},
    ("generate", "--elastomer"): {"--name": ["own"]},
    ("generate", "--illumination"): {"--name": ["own"]},
    ("generate", "--lights-like"): {"--name": ["own"]},
    ("calibrate", "--from-taxim"): {"presses": None, "--reference": None, "--sensor": None},
    ("predict", "--camera"): {"pictures": []},
    ("benchmark", "--data"): {"subject": ["real"]},
}
"""Where an option needs others than that, or none of one (None)."""

WRONG: dict[Any, dict[str, str]] = {
    int: {
        "text": "x",
        "part": "1.5",
        "nan": "nan",
        "infinite": "inf",
        "negative": "-1",
        "huge": HUGE,
        "½": "½",
    },
    float: {
        "text": "x",
        "nan": "nan",
        "infinite": "inf",
        "negative infinite": "-inf",
        "negative": "-1e9",
        "huge": "1e308",
        "½": "½",
    },
    str: {
        "unknown": "no-such-name",
        "unknown file": "no-such-file.toml",
        "folder": A_FOLDER,
        "file": A_FILE,
        "unicode": "ü☃/…",
        "huge": LONG,
        "number": "-1",
    },
    Path: {
        "not there": "no-such-folder/below/it",
        "folder": A_FOLDER,
        "file": A_FILE,
        "below a file": NO_FOLDER_HERE,
        "unwritable": "/proc/gelgap",
        "unicode": "ü☃",
    },
}
"""Wrong values by the type of an option: what is wrong, and the value."""

CALLED = {"further_indenters": "indenter", "source": "data set"}
"""What a room calls the option of a field."""

SAME_NUMBER = {"1e308": ("1e+308",), "-1e9": ("-1e+09", "-1000000000.0")}

ANY_NAME = "a domain may have any name that can be a folder's"
ALLOWED: dict[tuple[str | Check, str], str] = {
    (output_folder, "not there"): "an output folder is made",
    (output_folder, "folder"): "an output folder may be there",
    (output_folder, "unicode"): "a folder may have such a name",
    (output_file(), "file"): "an output file is replaced",
    (output_file(), "unicode"): "a file may have such a name",
    ("benchmark --data", "folder"): "which clones are missing is told when they are needed",
    ("generate --columns", "missing"): "no optional columns",
    ("generate --further-indenters", "missing"): "one indenter alone",
    ("pretrain --without", "missing"): "all is drawn",
    ("calibrate --from-taxim", "huge"): "of a name that is too long the system tells",
    ("convert --lag", "negative"): "forces may lead",
    ("generate --name", "unknown"): ANY_NAME,
    ("generate --name", "unknown file"): ANY_NAME,
    ("generate --name", "folder"): ANY_NAME,
    ("generate --name", "file"): ANY_NAME,
}
"""Values of the table above that are right after all, by option or by check, and why."""


WORK = {
    "sim.plan": "Solve.run",
    "domains.generation.generate": "run",
    "domains.formats.export": "_paper",
    "domains.formats.convert": "Clip.selected",
    "domains.generation.estimate": "picture_cells",
    "adapt.runs": "Stage1.model",
    "adapt.trainer": "Trainer.train",
    "adapt.report": "load_runs",
    "adapt.few_labels": "with_statistics_of",
    "render.renderer": "MembraneRenderer.linear",
    "render.calibration.fit": "LightFit.run",
    "benchmarks.registry": "Benchmark.run",
    "view.page": "viser.ViserServer",
}
"""Where work starts, by module."""


@dataclass(frozen=True)
class Option:
    """One option of a command, or one value without a name, which is called by its field."""

    field: str
    names: tuple[str, ...]
    type: Any
    positional: bool
    checks: tuple[Check, ...]

    @property
    def name(self) -> str:
        return self.field if self.positional else self.names[0]

    @property
    def is_switch(self) -> bool:
        return self.type is bool


def options_of(command: type) -> tuple[Option, ...]:
    hints = get_type_hints(command, include_extras=True)
    return tuple(option for field in fields(command) for option in _options(field.name, hints[field.name]))


def _options(field: str, hint: Any) -> tuple[Option, ...]:
    kind, notes = hint, []
    while get_origin(kind) is Annotated or NoneType in get_args(kind):
        kind, *more = (part for part in get_args(kind) if part is not NoneType)
        notes += more
    if is_dataclass(kind):
        return options_of(kind)
    settings = [note for note in notes if hasattr(note, "aliases")]
    name = next((note.name for note in settings if note.name), field)
    names = [f"--{name.replace('_', '-')}", *(alias for note in settings for alias in note.aliases or ())]
    checks = tuple(note for note in notes if isinstance(note, FunctionType))
    is_positional = get_args(tyro.conf.Positional[int])[1] in notes
    return (Option(field, tuple(names), kind, is_positional, checks),)


class WorkStarted(BaseException):
    """Something was computed before the input was refused."""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one right input of each kind."""
    folder = tmp_path_factory.mktemp("inputs")
    (folder / A_FOLDER).mkdir()
    (folder / A_FILE).write_text("text")
    real = folder / "real"
    real.mkdir()
    names = ["reference.png", *(f"{number}.png" for number in range(8))]
    for number, name in enumerate(names):
        cv2.imwrite(str(real / name), np.full((60, 80, 3), 20 * number, np.uint8))
    rows = [f"{name},0.1,0.2,-{number / 10}" for number, name in enumerate(names[1:])]
    (real / "table.csv").write_text("\n".join(["image,fx_n,fy_n,fz_n", *rows]))
    press = (
        '[[presses]]\npicture = "real/1.png"\nsphere_diameter_mm = 3.0\ndepth_mm = 0.6\npoint_mm = [0, 0]\n'
    )
    (folder / "presses.toml").write_text(3 * press)
    profile = Profile.preset("smoke").replace(width=0.125, feature_dim=16)
    untrained(open_domain(real), profile).save(folder / "checkpoint.pt")
    (folder / "finished").mkdir()
    (folder / "finished/run.json").write_text("{}")
    axis = np.linspace(-7, 7, 15)
    flat = np.zeros((15, 15, 3), np.float32)
    MembraneState(axis, axis, flat, np.zeros((15, 15), bool), np.zeros(3)).save(folder / "state.npz")
    return folder


@pytest.fixture
def nothing_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make work that starts an error."""

    def started(*_: Any, **__: Any) -> None:
        raise WorkStarted

    monkeypatch.setenv("GELGAP_CACHE", str(tmp_path / "cache"))
    for module, name in WORK.items():
        # A room's name may be that of a function in it, so modules are looked up by themselves.
        owner = import_module(f"gelgap.{module}")
        *inside, last = name.split(".")
        for step in inside:
            owner = getattr(owner, step)
        monkeypatch.setattr(owner, last, started)


def wrong_values(option: Option) -> Iterator[tuple[str, list[str], str]]:
    """Yield what is wrong, what is typed, and the value that the sentence must show."""
    if option.is_switch:
        yield "value of a switch", [f"{option.name}=1"], "1"
        return
    before = [] if option.positional else [option.names[0]]
    kinds = get_args(option.type) if get_origin(option.type) is tuple else (option.type,)
    kinds = [str if get_origin(kind) is Literal else kind for kind in kinds if kind is not Ellipsis]
    if before or option.field not in ("domains", "kind"):
        yield "missing", before, ""
    yield "empty", [*before, ""], "''"
    rest = [{int: "64", float: "20"}.get(kind, "") for kind in kinds[1:]]
    if rest:
        yield "too few", [*before, *rest], rest[0]
    for what, value in WRONG[kinds[0]].items():
        if option.positional and value.startswith("-"):
            continue
        yield what, [*before, value, *rest], value
        if rest:
            yield f"{what}, second", [*before, *rest, value], value


OWN_TO_AN_OPTION = ("value of a switch", "missing", "negative", "huge", "unknown", "not there")
"""Wrong values that are tried on every option; others depend on its type and its checks alone."""


def every_option() -> Iterator[Any]:
    """Yield each option; with all wrong values if it is the first of its type and checks, or slowly."""
    first = {}
    for command, definition in COMMANDS.items():
        for option in options_of(definition):
            kind = (str(option.type), option.checks)
            if first.setdefault(kind, option) is option:
                yield pytest.param(command, option, True, id=f"{command} {option.name}")
            else:
                yield pytest.param(command, option, False, id=f"{command} {option.name}")
                yield pytest.param(
                    command, option, True, id=f"{command} {option.name}, all", marks=pytest.mark.slow
                )


@pytest.mark.parametrize(("command", "option", "thorough"), tuple(every_option()))
def test_wrong_values_are_refused_in_one_sentence(
    command: str,
    option: Option,
    thorough: bool,
    place: Path,
    tmp_path: Path,
    nothing_works: None,
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = contents(place)
    wrong = []
    for number, (what, typed, value) in enumerate(wrong_values(option)):
        if not thorough and what not in OWN_TO_AN_OPTION:
            continue
        here = tmp_path / str(number)
        shutil.copytree(place, here)
        with contextlib.chdir(here):
            said = outcome(command, option, typed, capsys)
        problem = complaint(said, option, value) or (contents(here) != before and "wrote something")
        allowed = excuse(command, option, what) is not None
        if allowed != bool(problem):
            wrong.append(f"{what}: {' '.join(typed)[:60]}: {problem or 'refused, though it is excused'}")
    assert not wrong, "\n".join(wrong)


def outcome(command: str, option: Option, typed: list[str], capsys: Any) -> SimpleNamespace:
    """Run a command with one option as typed and the others right."""
    others = RIGHT[command] | BESIDE.get((command, option.name), {})
    mine = {option.field, *option.names}
    needed = {name: values for name, values in others.items() if name not in mine and values is not None}
    words = [word for name, values in needed.items() for word in _words(name, values)]
    # Values without a name come first, or a list of values would take them.
    arguments = [command, *typed, *words] if option.positional else [command, *words, *typed]
    code: Any = 0
    try:
        main(arguments)
    except SystemExit as stop:
        code = stop.code
    except WorkStarted:
        code = "work started"
    captured = capsys.readouterr()
    return SimpleNamespace(code=code, out=captured.out, err=captured.err)


def _words(name: str, values: list[str]) -> list[str]:
    return [name, *values] if name.startswith("-") else values


def complaint(said: SimpleNamespace, option: Option, value: str) -> str | None:
    """Return what is wrong with an answer, or None if the input was refused as it should be."""
    if said.code != 2:
        return f"exit code {said.code}: {said.err.strip()[:200]}"
    if said.out or said.err.count("\n") != 1 or not said.err.startswith("gelgap: ") or len(said.err) > 900:
        return f"not one sentence: {said.err[:200]!r}"
    # A value that is a file names itself, and the command line shows where a value is empty or missing.
    is_path = Path in (option.type, *get_args(option.type))
    if value and value[:30] in said.err and (is_path or "does not exist" in said.err):
        return None
    if "a value is empty: gelgap " in said.err:
        return None
    named = (
        *option.names,
        *(("PATH ",) if option.positional and is_path and "Missing from" in said.err else ()),
        option.field,
        option.field.replace("_", "-"),
        option.field.upper(),
        option.field.rstrip("s"),
        CALLED.get(option.field, option.field),
    )
    if not any(name in said.err for name in named):
        return f"does not name the option: {said.err.strip()[:200]}"
    shown = (value, *SAME_NUMBER.get(value, ()), "Missing value")
    if not any(form[:30] in said.err for form in shown):
        return f"does not show the value: {said.err.strip()[:200]}"
    return None


def excuse(command: str, option: Option, what: str) -> str | None:
    """Return why a value is right after all."""
    return next(
        (
            reason
            for of in (f"{command} {option.name}", *option.checks)
            if (reason := ALLOWED.get((of, what)))
        ),
        None,
    )


def contents(folder: Path) -> dict[str, bytes | None]:
    """Return every file below a folder with its bytes."""
    return {
        str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None
        for path in folder.rglob("*")
    }


def test_every_excuse_is_needed() -> None:
    tried = {
        (of, what)
        for command, definition in COMMANDS.items()
        for option in options_of(definition)
        for of in (f"{command} {option.name}", *option.checks)
        for what, *_ in wrong_values(option)
    }
    assert ALLOWED.keys() - tried == set()


def test_the_layouts_of_export_are_those_that_there_are() -> None:
    (option,) = (option for option in options_of(COMMANDS["export"]) if option.field == "format_name")
    assert set(get_args(option.type)) == set(import_module("gelgap.domains.formats.export").FORMATS)


def test_the_layouts_of_convert_are_those_that_there_are() -> None:
    (option,) = (option for option in options_of(COMMANDS["convert"]) if option.field == "layout")
    published = import_module("gelgap.benchmarks.real.published_sets").LAYOUTS
    assert set(get_args(option.type)) == set(import_module("gelgap.domains.formats.convert").LAYOUTS) | set(
        published
    )
