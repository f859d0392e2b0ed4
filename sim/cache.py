"""Solutions on disk, one file per key, safe for concurrent writers and for a crash."""

import time
from dataclasses import dataclass
from pathlib import Path

from gelgap.assets.locks import cache_folder
from gelgap.assets.whole_file import DAMAGED_SUFFIX, TEMPORARY_SUFFIX, set_aside, write_whole
from gelgap.sim.problem import ContactProblem
from gelgap.sim.solution import Solution, is_of_this_format, solution_bytes, solution_from_bytes

_SUFFIX = ".solution"


@dataclass(frozen=True)
class CacheUse:
    """How many solutions the cache holds, and their size."""

    folder: Path
    solutions: int
    bytes: int


@dataclass(frozen=True)
class CacheEntry:
    """One cached file: `problem` is None if it is damaged; `current` says whether this version would take it."""

    key: str
    bytes: int
    age_s: float
    problem: ContactProblem | None
    current: bool


def load_solution(key: str) -> Solution | None:
    """Return the cached solution of that key; None if there is none. A damaged file is named and set aside."""
    path = _path(key)
    try:
        data = path.read_bytes()
    except OSError:
        return None
    solution = solution_from_bytes(data)
    if solution is not None and solution.problem.key == key:
        return solution
    if solution is None and is_of_this_format(data):
        set_aside(path, "is damaged (its checksum does not match)")
    return None


def has_solution(key: str) -> bool:
    """Return whether there is a file for that key; only loading it says whether it is sound."""
    return _path(key).is_file()


def store_solution(solution: Solution) -> None:
    """Write a solution under its problem's key, or raise RuntimeError if the disk does not take it."""
    write_whole(_path(solution.problem.key), solution_bytes(solution))


def cache_use() -> CacheUse:
    """Count what the cache holds."""
    files = list(cache_folder().glob(f"*{_SUFFIX}"))
    return CacheUse(cache_folder(), len(files), sum(file.stat().st_size for file in files))


def cache_entries() -> tuple[CacheEntry, ...]:
    """Read what each cached file is, newest first."""
    entries = []
    for file in cache_folder().glob(f"*{_SUFFIX}"):
        try:
            about = file.stat()
        except FileNotFoundError:
            continue
        solution = _read(file)
        problem = None if solution is None else solution.problem
        current = problem is not None and problem.key == file.stem
        entries.append(CacheEntry(file.stem, about.st_size, time.time() - about.st_mtime, problem, current))
    return tuple(sorted(entries, key=lambda entry: entry.age_s))


def clear_cache() -> CacheUse:
    """Delete all cached solutions and return what there was."""
    use = cache_use()
    for suffix in (_SUFFIX, TEMPORARY_SUFFIX, DAMAGED_SUFFIX):
        for file in cache_folder().glob(f"*{suffix}"):
            file.unlink(missing_ok=True)
    return use


def _path(key: str) -> Path:
    return cache_folder() / f"{key}{_SUFFIX}"


def _read(path: Path) -> Solution | None:
    try:
        return solution_from_bytes(path.read_bytes())
    except OSError:
        return None
