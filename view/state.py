"""The live model: a configuration in, its picture and force out, with only the work that the last change needs."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from scipy.ndimage import uniform_filter

from gelgap.render import Illumination, Sensor
from gelgap.sim import Elastomer, LibraryPlan, Pose, PoseLibrary, PoseRanges, Sphere, solve_pose
from gelgap.sim.indenter import Floats, Symmetry
from gelgap.sim.library import PoseState
from gelgap.sim.problem import QualityName
from gelgap.sim.scene import is_interior
from gelgap.sim.shapes import AnyIndenter
from gelgap.view.pictures import LitSensor, Picture, PictureMaker, keep

SHALLOWEST_MM, DEEPEST_MM, FARTHEST_MM = 0.1, 1.0, 0.6
# One fewer than elsewhere: the page waits for it.
_DEPTHS = 4
# Libraries, and poses solved by themselves, that are kept: some MB each.
_KEPT_SOLUTIONS = 16


@dataclass(frozen=True)
class LibraryRequest:
    """The library of poses of a gel, from which all its poses are interpolated."""

    elastomer: Elastomer
    indenter: AnyIndenter

    @property
    def plan(self) -> LibraryPlan:
        ranges = PoseRanges(SHALLOWEST_MM, DEEPEST_MM, FARTHEST_MM)
        return LibraryPlan(self.elastomer, self.indenter, ranges, depths=_DEPTHS)


@dataclass(frozen=True)
class PoseRequest:
    """One pose, solved by itself."""

    elastomer: Elastomer
    indenter: AnyIndenter
    pose: Pose
    quality: QualityName


@dataclass(frozen=True)
class Configuration:
    """Everything that a picture and a force depend on: a press of one gel, seen by one sensor under one illumination.

    `quality` is that of the picture, and of the physics where a pose is solved by itself.
    """

    elastomer: Elastomer
    sensor: Sensor
    illumination: Illumination
    pose: Pose = field(default_factory=lambda: Pose(depth_mm=0.6))
    indenter: AnyIndenter = field(default_factory=Sphere)
    markers: bool = True
    noise: bool = False
    quality: QualityName = "standard"

    @property
    def library(self) -> LibraryRequest:
        return LibraryRequest(self.elastomer, self.indenter)

    @property
    def exact_pose(self) -> PoseRequest:
        return PoseRequest(self.elastomer, self.indenter, self.pose, self.quality)

    @property
    def lit(self) -> LitSensor:
        return LitSensor(self.sensor, self.illumination, self.quality)

    def library_keys(self) -> tuple[str, ...]:
        """Return the names of the solves that its library is made of; gels with the same ones share the library.

        There are none for a body that no library serves, whose poses are solved by themselves.

        Raises
        ------
        ValueError
            If the gel is too thin for the library.
        """
        body = self.indenter
        is_served = body.convex and body.symmetry is Symmetry.REVOLUTION and body.deepest_mm >= DEEPEST_MM
        return _library_keys(self.library) if is_served else ()


@lru_cache(maxsize=256)
def _library_keys(request: LibraryRequest) -> tuple[str, ...]:
    return tuple(solve.key for solve in request.plan.solved.solves)


@dataclass(frozen=True, eq=False)
class Shown:
    """What is seen of a configuration.

    `source` says in one sentence where the physics is from, and `exact` whether this very pose was solved. `stages_ms`
    is how long each stage took of what had to be done since what was shown before.
    """

    configuration: Configuration
    solved: PoseState
    picture: Picture
    source: str
    exact: bool
    stages_ms: dict[str, float]

    @property
    def pressure_mpa(self) -> Floats:
        """The normal pressure (ny, nx), a mean of 5 × 5 points, half a millimetre: of single ones it is off by half."""
        return uniform_filter(self.solved.pressure_mpa, 5)


@dataclass(frozen=True, eq=False)
class _Drawn:
    """What was shown last, and what its membrane and its picture depend on."""

    shown: Shown
    membrane: tuple[Any, ...]
    seen: tuple[Any, ...]


class LiveModel:
    """Shows configurations from libraries and poses that are added to it; call it from one thread only.

    Physics and picture are made anew only where something that they depend on has changed since what was shown before.
    """

    def __init__(self) -> None:
        self.pictures = PictureMaker()
        self._libraries: dict[tuple[str, ...], PoseLibrary] = {}
        self._last_library: PoseLibrary | None = None
        self._exact: dict[PoseRequest, PoseState] = {}
        self._before: _Drawn | None = None

    def lacks(self, configuration: Configuration) -> LibraryRequest | None:
        """Return the library that has to be solved for a configuration; None if it is there."""
        keys = configuration.library_keys()
        return None if not keys or keys in self._libraries else configuration.library

    def add_library(self, request: LibraryRequest, library: PoseLibrary) -> None:
        """Take in the library of a gel, and of all gels that share it."""
        keep(self._libraries, _library_keys(request), library, _KEPT_SOLUTIONS)
        self._before = None

    def add_pose(self, request: PoseRequest, solved: PoseState) -> None:
        """Take in a pose that was solved by itself."""
        keep(self._exact, request, solved, _KEPT_SOLUTIONS)
        self._before = None

    def show(self, configuration: Configuration) -> Shown:
        """Return what is seen; where its own library is not there yet, by the one of the gel before.

        Raises
        ------
        ValueError
            If the library does not reach the pose, or its membrane is folded.
        """
        before = self._before
        stages_ms: dict[str, float] = {}
        request = configuration.exact_pose
        solved_itself = request if request in self._exact else None
        membrane = configuration.library_keys(), configuration.pose, configuration.indenter, solved_itself
        seen = membrane, configuration.lit, configuration.markers, configuration.noise
        same_membrane = before is not None and before.membrane == membrane
        if before and same_membrane and before.shown.configuration.elastomer == configuration.elastomer:
            solved, source, exact = before.shown.solved, before.shown.source, before.shown.exact
        else:
            with _timed("force" if same_membrane else "membrane", stages_ms):
                solved, source, exact = self._solved(configuration)
        if before and before.seen == seen:
            picture = before.shown.picture
        else:
            with _timed("light", stages_ms):
                self.pictures.renderer(configuration.lit)
            with _timed("picture", stages_ms):
                picture = self.pictures.picture(
                    configuration.lit, solved, configuration.markers, configuration.noise
                )
        shown = Shown(configuration, solved, picture, source, exact, stages_ms)
        self._before = _Drawn(shown, membrane, seen)
        return shown

    def _solved(self, configuration: Configuration) -> tuple[PoseState, str, bool]:
        """Return the physics of a configuration, what to say about it, and whether this pose itself was solved."""
        request = configuration.exact_pose
        if request in self._exact:
            return self._exact[request], f"this pose, solved at {configuration.quality}", True
        keys = configuration.library_keys()
        library = self._libraries.get(keys)
        if not keys:
            said = "no contact is shown until this very pose is solved: press the button under Contact"
            return _flat(configuration), said, False
        if library is not None:
            self._last_library = library
            said = "interpolated between poses solved at draft"
            if not is_interior(configuration.elastomer, configuration.indenter, configuration.pose):
                said += "; the pad's edge, which is near, is left out"
        elif self._last_library is not None and self._last_library.plan.indenter == configuration.indenter:
            said = "until this gel is solved: the one before, its force scaled by Young's modulus"
        else:
            return _flat(configuration), "no contact is shown until this gel is solved", False
        return self._last_library.pose(configuration.elastomer, configuration.pose), said, False


def _flat(configuration: Configuration) -> PoseState:
    return solve_pose(configuration.elastomer, configuration.indenter, Pose(depth_mm=0.0))


@contextmanager
def _timed(stage: str, stages_ms: dict[str, float]) -> Iterator[None]:
    started = time.perf_counter()
    yield
    stages_ms[stage] = 1e3 * (time.perf_counter() - started)
