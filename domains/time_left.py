"""How long the rest of a generation takes, from what was expected and how fast it has been going."""

from collections.abc import Mapping
from dataclasses import dataclass

# What a process needs before its first task, s, at the built-in pace, and what a frame takes of a core: something for
# itself and something for each of its pixels.
START_S = 4.0
_FRAME_S = 0.006
_FRAME_PIXEL_S = 1e-7
# By how much the first steps may be unlike the others, and the share of the work that must be done to say so.
_UNLIKE = 1.4
_TELLING_SHARE = 0.02


@dataclass(frozen=True)
class SolveSize:
    """The load steps of a solve, and the seconds of a core that they are expected to take."""

    load_steps: int
    core_s: float


@dataclass(frozen=True)
class Workload:
    """What a generation is expected to take; `busy` is how many times slower the machine is than if it were idle.

    `solves` are those that the cache lacks, by their keys; `frame_core_s` is for one frame of one domain. `workers`
    share the solves (None: a cluster of others, at a pace that is not known), `renderers` of them the frames, and each
    starts for `start_s`.
    """

    solves: Mapping[str, SolveSize]
    frames: int
    frame_core_s: float
    workers: int | None
    renderers: int
    start_s: float = 0.0
    busy: float = 1.0


def frame_core_s(pixels: int, slowness: float) -> float:
    """Return the seconds of a core that a frame takes on a machine whose solves are `slowness` times slower."""
    return slowness * (_FRAME_S + _FRAME_PIXEL_S * pixels)


class TimeLeft:
    """Estimates the time left whenever something gets done; times are seconds since the generation began."""

    def __init__(self, load: Workload):
        self._load = load
        self._steps = dict.fromkeys(load.solves, 0)
        self._solving = _Part(sum(size.core_s for size in load.solves.values()))
        self._rendering = _Part(load.frames * load.frame_core_s)
        self._last_s: float | None = None

    @property
    def steps(self) -> int:
        """Load steps done, over all solves."""
        return sum(self._steps.values())

    @property
    def all_steps(self) -> int:
        """Load steps to do."""
        return sum(size.load_steps for size in self._load.solves.values())

    def step(self, solve: str, done: int, now_s: float) -> None:
        """Take note of the load steps that a solve has done; the news may come late."""
        sharing = min(self._load.workers or 1, sum(left_s > 0 for left_s in self._remaining_s()))
        if solve in self._steps:
            self._steps[solve] = max(self._steps[solve], done)
        # What passed before the first step was for starting.
        passed_s = None if self._last_s is None else now_s - self._last_s
        self._solving.advance(self._solving.expected_s - sum(self._remaining_s()), sharing, passed_s)
        self._last_s = now_s

    def solve(self, solve: str, now_s: float) -> None:
        """Take note that a solve is done."""
        size = self._load.solves.get(solve)
        self.step(solve, size.load_steps if size else 0, now_s)

    def write(self, frames: int, now_s: float) -> None:
        """Take note that this many more frames are written."""
        since_s = self._start_s if self._last_s is None else self._last_s
        done_s = self._rendering.done_s + frames * self._load.frame_core_s
        self._rendering.advance(done_s, self._load.renderers, max(0.0, now_s - since_s))
        self._last_s = now_s

    def left_s(self, now_s: float) -> float | None:
        """Return the seconds left; None where it is not known who works."""
        if self._load.workers is None:
            return None
        slowness = self._solving.slowness(self._load.busy)
        solves = [left_s * slowness for left_s in self._remaining_s()]
        # What slows solves down slows frames down, until these have shown a pace of their own.
        frames_s = (self._rendering.expected_s - self._rendering.done_s) * self._rendering.slowness(slowness)
        working_s = sum(solves) / self._load.workers + frames_s / self._load.renderers
        # One solve is not shared: the longest is the least that it takes.
        left_s = max([working_s, *solves])
        if self._last_s is None:
            return max(0.0, self._start_s - now_s) + left_s
        return max(0.0, left_s - (now_s - self._last_s))

    @property
    def _start_s(self) -> float:
        return self._load.start_s * self._load.busy

    def _remaining_s(self) -> list[float]:
        """Return what is expected of each solve's rest, in seconds of a core."""
        return [
            size.core_s * (1 - self._steps[key] / size.load_steps) for key, size in self._load.solves.items()
        ]


class _Part:
    """A part of the work: seconds of a core expected and done, and how long the timed ones of these took."""

    def __init__(self, expected_s: float):
        self.expected_s, self.done_s = expected_s, 0.0
        self._timed_core_s = self._timed_s = self._taken_s = 0.0

    def slowness(self, assumed: float) -> float:
        """Return how many times longer than expected it takes: at first what is assumed, then what is seen.

        The first steps of a solve are not like the others: until half of them are done, what is assumed counts too,
        as far as it is not much unlike what is seen.
        """
        if not (self._timed_s and self._taken_s):
            return assumed
        seen, share = self._taken_s / self._timed_s, self._timed_core_s / self.expected_s
        trust = min(1.0, 2 * share)
        believed = float(assumed ** (1 - trust) * seen**trust)
        return believed if share < _TELLING_SHARE else min(max(believed, seen / _UNLIKE), seen * _UNLIKE)

    def advance(self, done_s: float, sharing: int, passed_s: float | None) -> None:
        """Take note of what is done, by how many processes, and how long it took; None where that is not known."""
        if passed_s is not None:
            self._timed_core_s += done_s - self.done_s
            self._timed_s += (done_s - self.done_s) / max(sharing, 1)
            self._taken_s += passed_s
        self.done_s = done_s
