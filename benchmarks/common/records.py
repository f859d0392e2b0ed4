"""Finished measurements as lines of JSON, so that a benchmark that was stopped goes on where it was."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from gelgap.assets.checksums import (
    CHECKSUM,
    checksum_problem,
    file_sha256,
    parse_json,
    read_json,
    with_checksum,
    without_checksum,
    write_checksums,
)
from gelgap.assets.whole_file import warn
from gelgap.benchmarks.common.tables import plain, write_json

T = TypeVar("T")


def append_record(path: Path, record: Any) -> None:
    """Add a dataclass as one line with its checksum; a line that a kill left unfinished is ended first."""
    content = with_checksum(json.loads(json.dumps(record, default=plain)))
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+b") as file:
        if file.tell():
            file.seek(-1, 2)
            if file.read(1) != b"\n":
                file.write(b"\n")
        file.write((json.dumps(content, ensure_ascii=False) + "\n").encode())


def read_records(path: Path, kind: type[T]) -> list[T]:
    """Return the records of a file, none if it is not there.

    A line that a kill cut off is left out, and so is a damaged one, which is named: what it held is measured again.
    """
    records = []
    lines = path.read_bytes().split(b"\n") if path.is_file() else []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            content = parse_json(line)
            if isinstance(content, dict) and CHECKSUM in content:
                content = without_checksum(content)
            records.append(_typed(kind, content))
        except ValueError as error:
            if number < len(lines):
                warn(f"{path}, line {number}, is damaged ({_in_short(error)}): left out, and measured again")
    return records


def write_results(path: Path, results: Any) -> None:
    """Write results as `write_json` does, and their checksum to the folder's list, for `read_results`."""
    write_json(path, results)
    write_checksums(path.parent, {path.name: file_sha256(path)})


def read_results(path: Path, kind: type[T]) -> T:
    """Return what `write_results` wrote, as dataclasses and tuples again.

    Raises
    ------
    RuntimeError
        If the file is damaged.
    """
    if not (problem := checksum_problem(path)):
        try:
            return _typed(kind, read_json(path))
        except ValueError as error:
            problem = f"is damaged ({_in_short(error)})"
    raise RuntimeError(f"{path} {problem}; delete it and run the same benchmark again")


def _in_short(error: ValueError) -> str:
    return " ".join(str(error).split())[:120]


def _typed(kind: type[T], content: Any) -> T:
    from pydantic import TypeAdapter

    return TypeAdapter(kind).validate_python(content)


@dataclass(frozen=True)
class Note:
    """One finished measurement: the plan that it belongs to, its name and its value as JSON."""

    plan: Any
    name: str
    value: Any


class Ledger:
    """The measurements that a benchmark has finished; those of another plan are dropped.

    Parameters
    ----------
    path
        File of the notes; `close` removes it, so that the next benchmark measures anew.
    plan
        What the measurements depend on: anything that JSON can hold.
    """

    def __init__(self, path: Path, plan: Any):
        self._path, self._plan = path, json.loads(json.dumps(plan))
        self._notes = [note for note in read_records(path, Note) if note.plan == self._plan]
        if not self._notes:
            self.close()

    @property
    def found(self) -> bool:
        """Whether an earlier benchmark of this plan was stopped."""
        return bool(self._notes)

    def values(self, name: str, kind: type[T]) -> list[T]:
        """Return all that was noted under a name."""
        return [_typed(kind, note.value) for note in self._notes if note.name == name]

    def note(self, name: str, value: Any) -> None:
        """Keep a value; a name may have several."""
        content = json.loads(json.dumps(value, default=plain))
        self._notes.append(Note(self._plan, name, content))
        append_record(self._path, self._notes[-1])

    def once(self, name: str, kind: type[T], measure: Callable[[], T]) -> T:
        """Return what was noted under a name; measure and note it if nothing was."""
        if not self.values(name, kind):
            self.note(name, measure())
        return self.values(name, kind)[0]

    def close(self) -> None:
        """Forget the notes: all is done."""
        self._path.unlink(missing_ok=True)
