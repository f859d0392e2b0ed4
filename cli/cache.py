"""`gelgap cache`: what physics is kept on disk, and clearing it."""

import time
from dataclasses import dataclass
from datetime import timedelta
from typing import TYPE_CHECKING

from gelgap.cli import options as opt

if TYPE_CHECKING:
    from gelgap.sim.problem import ContactProblem


@dataclass(frozen=True)
class Cache(opt.Command):
    """List the solved physics that is kept on disk, or clear it.

    The folder is $GELGAP_CACHE, else gelgap in $XDG_CACHE_HOME, else ~/.cache/gelgap.

    For example:
      gelgap cache
      gelgap cache --clear
    """

    when_stopped = "what was deleted is gone; run the same command again to go on"

    clear: opt.Flag = False
    """Delete every cached solution, and shrunken pictures that do not lie beside their data."""

    def run(self, started: float) -> None:
        """List or clear the cache."""
        from gelgap.assets.locks import cache_folder
        from gelgap.data.frames.stored import clear_picture_cache
        from gelgap.sim.solution import cached_files, clear_cache

        files = cached_files()
        verb = "deleted" if self.clear else "holds"
        size = sum(file.stat().st_size for file in files)
        if self.clear:
            if pictures := clear_picture_cache():
                print(f"{pictures / 1e6:.1f} MB of shrunken pictures deleted")
            clear_cache()
        else:
            for entry in cache_entries():
                print(_line(entry))
        print(f"{cache_folder()} {verb} {len(files)} solutions, {size / 1e6:.1f} MB")


@dataclass(frozen=True)
class CacheEntry:
    """One cached file: `problem` is None if it cannot be read; `current` says whether this version would take it."""

    key: str
    bytes: int
    age_s: float
    problem: "ContactProblem | None"
    current: bool


def cache_entries() -> tuple[CacheEntry, ...]:
    """Read what each cached file is, newest first."""
    from gelgap.sim.solution import cached_files, read_solution

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


def _line(entry: CacheEntry) -> str:
    age = timedelta(seconds=max(0, round(entry.age_s)))
    head = f"{entry.key[:12]}  {entry.bytes / 1e6:6.2f} MB  {age!s:>17} old"
    problem = entry.problem
    if problem is None:
        return f"{head}  damaged, or of an older version"
    edges, mount_n_per_mm = problem.pad_mm, problem.mount_stiffness_n_per_mm
    static = problem.static_friction
    parts = [
        problem.quality.name,
        f"{len(problem.waypoints_mm)} poses, deepest {max(-z for _, _, z in problem.waypoints_mm):g} mm",
        problem.indenter.label,
        f"gel {problem.thickness_mm:g} mm",
        f"MuJoCo's E {problem.moduli.young_modulus_mpa:.4g} MPa, ν {problem.moduli.poisson_ratio:.4g}",
        f"friction {problem.friction:g}" + (f", static {static:g}" if static is not None else ""),
        "rigid mount" if mount_n_per_mm is None else f"mount {mount_n_per_mm:g} N/mm",
        "edges far" if edges is None else "edges at x {:g} and {:g}, y {:g} and {:g} mm".format(*edges),
        *([] if entry.current else ["of another version: not used"]),
    ]
    return f"{head}  {'; '.join(parts)}"
