"""What lies in the cache of solutions, for whoever lists it."""

import time
from dataclasses import dataclass

from gelgap.sim.problem import ContactProblem
from gelgap.sim.solution import cached_files, read_solution


@dataclass(frozen=True)
class CacheEntry:
    """One cached file: `problem` is None if it cannot be read; `current` says whether this version would take it."""

    key: str
    bytes: int
    age_s: float
    problem: ContactProblem | None
    current: bool


def cache_entries() -> tuple[CacheEntry, ...]:
    """Read what each cached file is, newest first."""
    entries = []
    for file in cached_files():
        try:
            about = file.stat()
        except FileNotFoundError:
            continue
        solution = read_solution(file)
        problem = None if solution is None else solution.problem
        current = problem is not None and problem.key == file.stem
        entries.append(CacheEntry(file.stem, about.st_size, time.time() - about.st_mtime, problem, current))
    return tuple(sorted(entries, key=lambda entry: entry.age_s))
