"""Pictures of drawn presses while a network trains: nothing on disk but solves, which are few."""

import logging
import math
from collections.abc import Iterator
from functools import lru_cache
from itertools import count
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from gelgap.assets.names import one_line
from gelgap.data.formats.pictures import encode_png
from gelgap.data.frames.dataset import ArrayFrames, LabelledFrames
from gelgap.data.frames.joined import join_domains
from gelgap.data.frames.run_labels import within_range
from gelgap.data.random_stream import word
from gelgap.domains.pretraining import SHARE_OF_VIEW, Draws, PretrainingRanges
from gelgap.render import MembraneRenderer
from gelgap.sim import Elastomer, LibraryPlan, Pose, PoseLibrary, PoseRanges
from gelgap.sim.library import solve_all
from gelgap.sim.problem import QualityName
from gelgap.sim.solution import has_solution

LOG = logging.getLogger(__name__)
# Samples until the next gel and sphere joins those that are drawn from: the first picture waits for one alone.
_SAMPLES_PER_PRESS = 512
# Samples in a row that share lights with cameras, and how many of these: each takes as long as some pictures.
_SPAN = 128
_LOOKS_PER_SPAN = 4
_KEPT_LOOKS = 2 * _LOOKS_PER_SPAN
# Depths begin at this share of the deepest, and are drawn so that forces are about evenly spread.
_SHALLOWEST = 0.15
# Fewer than a library has otherwise, so that the first picture comes sooner.
_DEPTHS = 4
_UNTOUCHED = 1 / 32
_MOST_TRIES = 16
# What a sample tells of what was drawn.
_OF_GEL = ("young_modulus_mpa", "poisson_ratio", "friction", "thickness_mm")
_OF_POSE = ("depth_mm", "shear_x_mm", "shear_y_mm", "point_x_mm", "point_y_mm")
_OF_ERROR = ("fz_error_n", "shear_error_n")


class PressSample(NamedTuple):
    """One press: uint8 (h, w, 3) pictures of it and of its gel untouched, force (3,) in N, and all that was drawn.

    `draw` holds numbers by name: gel, sphere, contact, which press and look, the estimates of the force's error, and
    `tries`, above 1 if contacts before it could not be seen (their membranes fold).
    """

    number: int
    picture: np.ndarray
    reference: np.ndarray
    force_n: np.ndarray
    draw: dict[str, float]

    def __repr__(self) -> str:
        x_n, y_n, z_n = self.force_n
        return f"PressSample({self.number}, force ({x_n:+.3f}, {y_n:+.3f}, {z_n:+.3f}) N)"

    def _repr_png_(self) -> bytes:
        """Return the picture beside its reference, which notebooks show."""
        return encode_png(np.hstack([self.picture, self.reference]))


class _Look(NamedTuple):
    """A sensor in its light, and its picture of the untouched gel."""

    renderer: MembraneRenderer
    markers: bool
    reference: np.ndarray


@lru_cache(_KEPT_LOOKS)
def _look(draws: Draws, number: int, size_px: tuple[int, int], quality: QualityName) -> _Look:
    sensor, illumination, markers = draws.seen_by(number)
    renderer = MembraneRenderer(sensor, illumination, size_px, quality)
    return _Look(renderer, markers, renderer.reference(markers, draws.stream("reference of a look", number)))


class PressStream(IterableDataset):
    """Endless samples of presses whose gel, sphere, contact, light, camera, markers and noise are drawn from ranges.

    Sample n is the same whatever the workers, and whatever came before: `stream.sample(n)`. Gels and spheres come in
    one after another, each with its library of poses, solved when it is first drawn and cached; `prepare` solves all.
    Workers of a DataLoader of the same `batch_size` take batches in turn, so that batches are the same, too.

    Parameters
    ----------
    ranges
        What is drawn: settings, a TOML file of `gelgap pretrain`, or gelgap's own.
    seed
        Of all draws.
    size_px, quality
        Width and height of the pictures; quality of physics and pictures.
    start, stop
        The first sample, to resume, and the one after the last; endless without.

    Raises
    ------
    ValueError
        If a range is wrong, or `stop` before `start`.
    """

    def __init__(
        self,
        ranges: PretrainingRanges | Path | str | None = None,
        *,
        seed: int = 0,
        size_px: tuple[int, int] = (320, 240),
        quality: QualityName = "draft",
        start: int = 0,
        stop: int | None = None,
        batch_size: int = 32,
    ) -> None:
        if isinstance(ranges, Path | str):
            ranges = PretrainingRanges.load(ranges)
        if start < 0 or (stop is not None and stop < start):
            raise ValueError(f"start = {start}, stop = {stop}: samples are counted from 0, in rising order")
        if batch_size < 1:
            raise ValueError(f"batch_size = {batch_size}: must be 1 or more")
        self.ranges = ranges or PretrainingRanges.default()
        self.seed = seed
        self.size_px = size_px
        self.quality = quality
        self.start = start
        self.stop = stop
        self.batch_size = batch_size
        self._draws = Draws(self.ranges, seed)
        self._libraries: dict[int, PoseLibrary] = {}

    __repr__ = one_line

    def __iter__(self) -> Iterator[PressSample]:
        info = get_worker_info()
        worker, workers = (info.id, info.num_workers) if info else (0, 1)
        for batch in count(worker, workers):
            first = self.start + batch * self.batch_size
            for index in range(first, first + self.batch_size):
                if self.stop is not None and index >= self.stop:
                    return
                yield self.sample(index)

    def loader(self, workers: int = 0) -> DataLoader:
        """Return batches as a `PressSample` of tensors; a worker that dies is a RuntimeError, and no solve is lost."""
        context = {"multiprocessing_context": "spawn", "persistent_workers": True} if workers else {}
        return DataLoader(
            self, self.batch_size, num_workers=workers, worker_init_fn=_with_one_thread, **context
        )

    def prepare(self) -> None:
        """Solve the libraries of all presses now."""
        for press in range(self.ranges.presses):
            self.library(press)

    def library(self, press: int) -> PoseLibrary:
        """Return the library of poses of a gel and sphere; `.plan.served_by` would tell its error on held-out poses."""
        if press not in self._libraries:
            plan = self.plan(press)
            left_s = [solve.expected_core_s for solve in plan.solved.solves if not has_solution(solve.key)]
            if left_s:
                LOG.warning(
                    "gel and sphere %d of %d are solved first, once: %d solves, about %.0f s of a core",
                    *(press + 1, self.ranges.presses, len(left_s), sum(left_s)),
                )
            # Workers that wait for the same library begin with different solves of it.
            solves = plan.solved.solves
            info = get_worker_info()
            first = info.id % len(solves) if info else 0
            self._libraries[press] = plan.build(solve_all((*solves[first:], *solves[:first])))
        return self._libraries[press]

    def plan(self, press: int) -> LibraryPlan:
        """Return what has to be solved for a gel and sphere."""
        drawn = self._draws.press(press)
        farthest = self.ranges.travel_by_depth[1]
        deepest_mm = drawn.contacts_mm[-1][0]
        ranges = PoseRanges(_SHALLOWEST * deepest_mm, deepest_mm, farthest * deepest_mm, farthest)
        gel = Elastomer(young_modulus_mpa=self._draws.at("young_modulus_mpa", 0.5), **drawn.gel)
        return LibraryPlan(gel, drawn.indenter, ranges, self.quality, _DEPTHS)

    def sample(self, index: int) -> PressSample:
        """Return sample `index`.

        Raises
        ------
        RuntimeError
            If none of many drawn contacts can be seen.
        """
        rng = np.random.default_rng(np.random.SeedSequence([self.seed, word("stream"), index]))
        opened = min(1 + index // _SAMPLES_PER_PRESS, self.ranges.presses)
        press = int(rng.integers(opened))
        number = index // _SPAN * _LOOKS_PER_SPAN + int(rng.integers(_LOOKS_PER_SPAN))
        look = _look(self._draws, number, self.size_px, self.quality)
        library = self.library(press)
        (modulus,) = self._draws.values("modulus of a sample", index, "young_modulus_mpa")
        gel = library.plan.elastomer.model_copy(update={"young_modulus_mpa": modulus})
        lattice = look.renderer.lattice
        why = None
        for tries in range(1, _MOST_TRIES + 1):
            pose = self._pose(rng, library.plan.ranges, look)
            state = library.state(gel, pose, axes_mm=(lattice.x_mm, lattice.y_mm))
            try:
                if not state.converged:
                    raise ValueError("a pose around it did not converge")
                membrane = state.x_mm, state.y_mm, state.displacement_mm
                picture = look.renderer.picture(*membrane, look.markers, rng, f"sample {index}")
            except ValueError as error:
                why = error
                continue
            draw = {
                "press": press,
                "look": number,
                "tries": tries,
                "sphere_diameter_mm": self._draws.press(press).indenter.diameter_mm,
                "contact_radius_mm": state.contact_radius_mm,
            }
            for told, names in ((gel, _OF_GEL), (pose, _OF_POSE), (state.diagnostics, _OF_ERROR)):
                draw |= {name: getattr(told, name) for name in names}
            numbers = {name: float(value) for name, value in draw.items()}
            return PressSample(index, picture, look.reference, state.force_n.astype(np.float32), numbers)
        raise RuntimeError(f"sample {index}: {_MOST_TRIES} drawn contacts cannot be seen; the last: {why}")

    def _pose(self, rng: np.random.Generator, ranges: PoseRanges, look: _Look) -> Pose:
        untouched, depth, travel, angle, x, y = rng.random(6).tolist()
        view_mm = look.renderer.sensor.camera.footprint_mm(self.size_px)
        point_mm = [
            SHARE_OF_VIEW * ((2 * share - 1) * side / 2) for share, side in zip((x, y), view_mm, strict=True)
        ]
        if untouched < _UNTOUCHED:
            return Pose(0.0, 0.0, 0.0, *point_mm)
        # Force grows about as the square of the depth.
        low, high = ranges.shallowest_mm, ranges.deepest_mm
        depth_mm = math.sqrt(low**2 + depth * (high**2 - low**2))
        travel_mm = self._draws.at("travel_by_depth", travel) * depth_mm
        turn = 2 * math.pi * angle
        return Pose(depth_mm, travel_mm * math.cos(turn), travel_mm * math.sin(turn), *point_mm)

    def frames(self, start: int, stop: int) -> LabelledFrames:
        """Return samples start…stop as labelled frames in memory, without those of forces outside the declared range.

        Raises
        ------
        ValueError
            If no force is within the range.
        """
        of_look: dict[float, list[PressSample]] = {}
        for index in range(start, stop):
            sample = self.sample(index)
            of_look.setdefault(sample.draw["look"], []).append(sample)
        parts = []
        for look, samples in of_look.items():
            frames = ArrayFrames(
                f"look {look:.0f}",
                np.stack([sample.picture for sample in samples]),
                samples[0].reference,
                np.stack([sample.force_n for sample in samples]).astype(float),
                force_range_n=np.array(self.ranges.force_range_n),
            )
            within = within_range(frames)
            if len(within):
                parts.append(within)
        if not parts:
            raise ValueError(f"samples {start} to {stop}: no force is within force_range_n")
        return join_domains(parts)


def _with_one_thread(worker: int) -> None:
    """Give a worker process one thread of OpenCV and torch: there is one for each core."""
    import cv2

    cv2.setNumThreads(1)
    torch.set_num_threads(1)
