"""What a value of the command line may be: rules that its definition carries, checked before anything starts."""

import os
import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from gelgap.assets import list_presets
from gelgap.assets.names import closest_name, quoted


@runtime_checkable
class Rule(Protocol):
    """Says what is wrong with an option's value."""

    def problem(self, value: Any) -> str | None:
        """Return what is wrong and what would be right, or None if the value may pass."""


@dataclass(frozen=True)
class Between:
    """A number in [low, high]; of several, each."""

    low: float
    high: float
    unit: str = ""

    def problem(self, value: Any) -> str | None:
        values = value if isinstance(value, tuple) else (value,)
        if all(self.low <= number <= self.high for number in values):
            return None
        return f"must lie in [{self.low}, {self.high}] {self.unit}".rstrip()


SEED = Between(0, 2**63 - 1)
WORKERS = Between(1, 4096)
PICTURE_SIDES = Between(16, 4096, "px")


@dataclass(frozen=True)
class OneOf:
    """A known name, or several; the names are looked up when they are needed."""

    names: Callable[[], tuple[str, ...]]
    several: bool = False

    def problem(self, value: Any) -> str | None:
        values = value if self.several else (value,)
        known = self.names()
        unknown = [name for name in values if name not in known]
        if values and not unknown:
            return None
        if not unknown:
            return f"name at least one; known: {', '.join(known)}"
        which = f"{quoted(unknown[0])} is unknown" if len(values) > 1 else "is unknown"
        return f"{which};{closest_name(unknown[0], known)} known: {', '.join(known)}"


@dataclass(frozen=True)
class Preset:
    """A preset's name, or a TOML file unless there are none of that kind."""

    kind: str
    or_file: bool = True

    def problem(self, value: str) -> str | None:
        if self.or_file and value.endswith(".toml"):
            return InputFile("a TOML file").problem(Path(value))
        known = list_presets(self.kind)
        if value in known:
            return None
        file = ", or a file whose name ends in .toml" if self.or_file else ""
        return f"must be a preset of {self.kind}{file};{closest_name(value, known)} known presets: {', '.join(known)}"


@dataclass(frozen=True)
class InputFile:
    """A file that is there."""

    what: str
    hint: str = ""

    def problem(self, value: Path) -> str | None:
        return _not_there(value, self.what, Path.is_file, "is a folder", self.hint.format(path=_short(value)))


@dataclass(frozen=True)
class InputFolder:
    """A folder that is there."""

    what: str

    def problem(self, value: Path) -> str | None:
        return _not_there(value, self.what, Path.is_dir, "is a file", "")


@dataclass(frozen=True)
class TaximPackage:
    """Presses of the package taxim, by name, or a folder with such files."""

    def problem(self, value: str) -> str | None:
        try:
            known = value in ("gelsight", "gelsight_mini") or (Path(value) / "dataPack.npz").is_file()
        except OSError:
            known = False
        return None if known else "must be gelsight, gelsight_mini, or a folder with a dataPack.npz"


@dataclass(frozen=True)
class DataSet:
    """The folder of a domain, or of several if `several`, in a layout that is known; of several folders, each."""

    several: bool = False

    def problem(self, value: Path | tuple[Path, ...]) -> str | None:
        if isinstance(value, tuple):
            if not value:
                return "name one folder, or several"
            problems = ((path, self.problem(path)) for path in value)
            found = next(((path, problem) for path, problem in problems if problem), None)
            return found and (found[1] if len(value) == 1 else f"{_short(found[0])} {found[1]}")
        whats = "the folder of one domain, or of several," if self.several else "the folder of a domain"
        if missing := InputFolder(whats).problem(value):
            return missing
        from gelgap.domains import domain_folders, layout_problem

        folders = domain_folders(value) if self.several else (value,)
        return next((problem for folder in folders if (problem := layout_problem(folder))), None)


@dataclass(frozen=True)
class FinishedRuns:
    """A folder with finished runs of `gelgap adapt` or of the benchmark, at any depth."""

    def problem(self, value: Path) -> str | None:
        if missing := InputFolder("a folder with runs of gelgap adapt").problem(value):
            return missing
        if any(value.rglob("run.json")) or any(value.glob("*.jsonl")):
            return None
        return f"holds no finished adaptation run; `gelgap adapt … --out {value}` writes one"


@dataclass(frozen=True)
class OutputFile:
    """A file that can be written, in a folder that is there."""

    suffixes: tuple[str, ...] = ()

    def problem(self, value: Path) -> str | None:
        if self.suffixes and value.suffix.lower() not in self.suffixes:
            return f"the name must end in {', '.join(self.suffixes)}"
        try:
            if value.is_dir():
                return "is a folder; name a file"
            if not value.parent.is_dir():
                return f"the folder {value.parent} does not exist; create it first"
            if value.exists() and not os.access(value, os.W_OK):
                return "cannot be written to; name another file"
        except OSError as error:
            return f"cannot be written ({error.strerror}); name another file"
        return _unwritable(value.parent)


@dataclass(frozen=True)
class OutputFolder:
    """A folder that can be written to, or can be made."""

    def problem(self, value: Path) -> str | None:
        try:
            there = next(path for path in (value, *value.absolute().parents) if path.exists())
        except OSError as error:
            return f"cannot be made ({error.strerror}); name another folder"
        if not there.is_dir():
            return "is a file; name a folder" if there == value else f"{there} is a file; name another folder"
        return _unwritable(there)


_SCHEDULER_ADDRESS = re.compile(r"((tcp|tls|ucx|wss?)://)?[^\s/]+:\d{1,5}/?|inproc://\S+")


@dataclass(frozen=True)
class Scheduler:
    """`synchronous`, or an address with a port."""

    def problem(self, value: str) -> str | None:
        if value == "synchronous" or _SCHEDULER_ADDRESS.fullmatch(value):
            return None
        return "must be synchronous (this process) or the address of a Dask scheduler such as tcp://host:8786"


def _not_there(
    path: Path, what: str, is_right: Callable[[Path], bool], wrong_kind: str, hint: str
) -> str | None:
    try:
        if is_right(path):
            return None if os.access(path, os.R_OK) else f"cannot be read; {what} is needed"
        found = wrong_kind if path.exists() else "does not exist"
    except OSError as error:
        found = f"cannot be opened ({error.strerror})"
    return f"{found}; {what} is needed{hint}"


def _short(path: Path) -> str:
    return quoted(str(path)).strip("'")


def _unwritable(folder: Path) -> str | None:
    """Return what is wrong if no file can be made in a folder; for root, permissions alone do not tell."""
    try:
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return f"the folder {folder} cannot be written to ({error.strerror}); name another"
