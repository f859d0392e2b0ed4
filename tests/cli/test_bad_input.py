"""Each check that an option has refuses a wrong value in one sentence, before anything starts."""

import os
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any, get_args, get_type_hints

import pytest

from gelgap.cli.main import COMMANDS, main
from gelgap.cli.options import OutputFile

WRONG: dict[str, tuple[str, str]] = {
    "between": ("press --force-n nan", "--force-n = 'nan': must lie in [1e-06, 10000] N"),
    "input_folder": ("export no-such-folder --out o", "no-such-folder"),
    "OutputFile": ("press --save file.txt/below.npz", "--save = 'file.txt/below.npz': the folder file.txt"),
    "output_folder": ("generate mb0i0 --out file.txt/below", "file.txt is a file; name a folder"),
    "workers": ("generate mb0i0 --out x --workers foo", "--workers = 'foo': scheduler 'foo' must be"),
    "check_what": ("generate mb9i0 --out o", "what = 'mb9i0': domain 'mb9i0' is unknown"),
    "list_presets": ("presets gels", "kind = 'gels'"),
    "force_ranges": ("generate mb0i0 --out o --range fz_n=0", "--range = 'fz_n=0'"),
    "label_ranges": ("adapt --source . --target . --range fz_n=0", "--range = 'fz_n=0'"),
    "finished_runs": ("report no-such-folder", "folder = 'no-such-folder'"),
    "check_selector": ("adapt --source . --target . --select magic", "--select = 'magic'"),
    "check_mm_per_px": (
        "calibrate p.toml --reference r.png --mm-per-px 15.9 -o f.toml",
        "15.9 pixels per mm are 0.0629 mm per pixel",
    ),
    "check_methods": ("adapt --source . --target . --method magic", "--method = 'magic'"),
}
"""For each check a command line with a wrong value, and what the sentence says."""


def checks_of(options: type) -> Iterator[str]:
    """Yield the names of the checks in a command's annotations, also in those of its groups of options."""
    hints = get_type_hints(options, include_extras=True)
    for field in fields(options):
        yield from _checks_in(hints[field.name])


def _checks_in(hint: Any) -> Iterator[str]:
    if isinstance(hint, type) and is_dataclass(hint):
        yield from checks_of(hint)
    for note in (*get_args(hint), *getattr(hint, "__metadata__", ())):
        if isinstance(note, FunctionType):
            yield note.__qualname__.partition(".")[0]
        elif isinstance(note, OutputFile):
            yield type(note).__name__
        else:
            yield from _checks_in(note)


def test_every_check_has_a_wrong_value_here() -> None:
    assert {name for command in COMMANDS.values() for name in checks_of(command)} == WRONG.keys()


@pytest.mark.parametrize("check", WRONG)
def test_a_wrong_value_is_one_sentence_and_nothing_is_written(
    check: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file.txt").touch()
    monkeypatch.chdir(tmp_path)
    words, sentence = WRONG[check]
    with pytest.raises(SystemExit) as stop:
        main(words.split())
    said = capsys.readouterr()
    assert (stop.value.code, said.out, said.err.count("\n")) == (2, "", 1)
    assert sentence in said.err
    assert os.listdir() == ["file.txt"]


def test_two_outputs_do_not_share_a_file(refused: Callable[..., str], tmp_path: Path) -> None:
    words = ("press", "--save", tmp_path / "a.npz", "--traction", f"{tmp_path}/./a.npz")
    assert "--save and --traction name the same file" in refused(*words)


def options_of(command: str, field: str) -> set[str]:
    hint = get_type_hints(COMMANDS[command])[field]
    return set(get_args(hint))


def test_the_layouts_of_export_and_convert_are_those_that_there_are() -> None:
    assert options_of("export", "format_name") == set(import_module("gelgap.data.formats.export").FORMATS)
    published = import_module("gelgap.data.formats.published_sets").LAYOUTS
    own = import_module("gelgap.data.formats.convert").LAYOUTS
    assert options_of("convert", "layout") == set(own) | set(published)


@pytest.mark.parametrize(("name", "option"), [(n, o) for n, one in COMMANDS.items() for o in one.former])
def test_what_former_versions_took_is_one_sentence_with_the_last_of_them(
    name: str, option: str, refused: Callable[..., str]
) -> None:
    said = refused(name, *option.split())
    assert f"gelgap 0.3.0 was the last with {option}: " in said
    assert said == refused(name, option.replace(" ", "="))
