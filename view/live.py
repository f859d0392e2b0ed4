"""The live model: a configuration in, its picture and force out, with only the work that the last change needs."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from gelgap.sim import SolvedPath, SolvedPose, is_interior
from gelgap.view.configuration import ALL_WORK, Configuration, Work, needed_work
from gelgap.view.pictures import Picture, PictureMaker
from gelgap.view.requests import PathRequest, PoseRequest

# Paths, and poses solved by themselves, that are kept: some MB each.
_KEPT_SOLUTIONS = 16


@dataclass(frozen=True, eq=False)
class Shown:
    """What is seen of a configuration.

    `source` says in one sentence where the physics is from, and `exact` whether this very pose was solved. `work` is
    what had to be done since what was shown before, and `stages_ms` how long each stage of it took.
    """

    configuration: Configuration
    solved: SolvedPose
    picture: Picture
    source: str
    exact: bool
    work: Work
    stages_ms: dict[str, float]

    @property
    def physics(self) -> tuple[SolvedPose, str, bool]:
        """The part that light does not change: `solved`, `source` and `exact`."""
        return self.solved, self.source, self.exact


class LiveModel:
    """Shows configurations from solved paths and poses that are added to it; call it from one thread only."""

    def __init__(self) -> None:
        self.pictures = PictureMaker()
        self._paths: dict[tuple[str, ...], SolvedPath] = {}
        self._last_path: SolvedPath | None = None
        self._exact: dict[PoseRequest, SolvedPose] = {}
        self._shown: Shown | None = None

    def lacks(self, configuration: Configuration) -> PathRequest | None:
        """Return the path that has to be solved for a configuration; None if it is there."""
        if configuration.path_keys() in self._paths:
            return None
        return PathRequest(configuration.elastomer, configuration.indenter)

    def add_path(self, request: PathRequest, path: SolvedPath) -> None:
        """Take in the path of a gel, and of all gels that share it."""
        _keep(self._paths, request.keys(), path)
        self._shown = None

    def add_pose(self, request: PoseRequest, solved: SolvedPose) -> None:
        """Take in a pose that was solved by itself."""
        _keep(self._exact, request, solved)
        self._shown = None

    def show(self, configuration: Configuration) -> Shown:
        """Return what is seen; where its own path is not there yet, by the path of the gel before.

        Raises
        ------
        ValueError
            If the pose is off the path, or its membrane is folded.
        """
        before, watch = self._shown, _Stopwatch()
        work = ALL_WORK if before is None else needed_work(before.configuration, configuration)
        request = PoseRequest.of(configuration)
        if before is not None and (before.exact or request in self._exact):
            work |= Work.FORCE | Work.MEMBRANE | Work.PICTURE
        solved, source, exact = (None, "", False) if before is None else before.physics
        if work & (Work.FORCE | Work.MEMBRANE):
            with watch.stage("membrane" if Work.MEMBRANE in work else "force"):
                solved, source, exact = self._solved(configuration)
        picture = None if before is None else before.picture
        if work & (Work.PICTURE | Work.LIGHT):
            with watch.stage("light"):
                self.pictures.light(configuration)
            with watch.stage("picture"):
                picture = self.pictures.picture(configuration, solved.state)
        self._shown = Shown(configuration, solved, picture, source, exact, work, watch.stages_ms)
        return self._shown

    def _solved(self, configuration: Configuration) -> tuple[SolvedPose, str, bool]:
        """Return the physics of a configuration, what to say about it, and whether this pose itself was solved."""
        request = PoseRequest.of(configuration)
        if request in self._exact:
            return self._exact[request], f"this pose, solved at {configuration.quality}", True
        elastomer, pose = configuration.elastomer, configuration.pose
        path = self._paths.get(configuration.path_keys())
        if path is not None:
            self._last_path = path
            said = "interpolated between the poses of a path solved at draft" + _at_the_edge(configuration)
            return path.pose(elastomer, pose), said, False
        if self._last_path is not None:
            said = "until this gel is solved: the one before, its force scaled by Young's modulus"
            return self._last_path.pose(elastomer, pose), said, False
        return SolvedPose.untouched(), "no contact is shown until this gel is solved", False


def _keep(kept: dict, key: object, value: object) -> None:
    """Keep one more; the oldest goes where there are too many."""
    kept.pop(key, None)
    if len(kept) >= _KEPT_SOLUTIONS:
        del kept[next(iter(kept))]
    kept[key] = value


def _at_the_edge(configuration: Configuration) -> str:
    interior = is_interior(configuration.elastomer, configuration.pose)
    return "" if interior else "; the pad's edge, which is near, is left out"


@dataclass
class _Stopwatch:
    """Measures the stages of one picture."""

    stages_ms: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self.stages_ms[name] = 1e3 * (time.perf_counter() - started)
