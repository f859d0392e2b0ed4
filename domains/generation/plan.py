"""What has to be done for a set of domains: distinct solves, libraries of poses, and batches of frames, each once."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from gelgap.assets.checksums import canonical_json, sha256
from gelgap.data.formats.domain_folder import shard_name
from gelgap.domains.recipe import DomainRecipe
from gelgap.sim import (
    ContactPath,
    Elastomer,
    LibraryPlan,
    Pose,
    PoseLibrary,
    PosePath,
    PoseRanges,
    plan_solves,
)
from gelgap.sim.indenter import Indenter
from gelgap.sim.library import PoseState, joined
from gelgap.sim.plan import Solve, SolvePlan
from gelgap.sim.scene import is_interior

PoseSource = Solve | LibraryPlan
"""What poses follow from: a solve, or a library of poses, which is made of several."""
FRAMES_PER_SHARD = 128


@dataclass(frozen=True)
class Contacts:
    """The poses of a plan, one for each frame, and the solve that each follows from, or the library of poses.

    `libraries` has the library by the number of each pose that it serves; the plan's `placements` have the others.
    """

    plan: SolvePlan
    libraries: Mapping[int, LibraryPlan] = field(default_factory=dict)

    @classmethod
    def interpolated(
        cls,
        gel: Elastomer,
        indenter: Indenter,
        path: ContactPath | PosePath,
        quality: str,
        reach_mm: tuple[float, float, float] | None = None,
    ) -> "Contacts":
        """Return the contacts of a path, from a library where it serves them, and `reach_mm` (`PoseRanges.of`)."""

        def is_served(pose: Pose) -> bool:
            plain = pose.depth_mm > 0 and pose.trajectory is None and not any(pose.turn_deg)
            return plain and is_interior(gel, indenter, pose)

        poses = path.poses
        served = [index for index, pose in enumerate(poses) if is_served(pose)]
        others = [index for index, pose in enumerate(poses) if not is_served(pose)]
        plan = plan_solves(
            gel, indenter, PosePath(path.name, tuple(poses[index] for index in others)), quality
        )
        placements = {others[number]: placement for number, placement in plan.placements.items()}
        plan = replace(plan, poses=poses, placements=placements)
        if not served:
            return cls(plan)
        ranges = PoseRanges.of([poses[index] for index in served], reach_mm)
        return cls(plan, dict.fromkeys(served, LibraryPlan(gel, indenter, ranges, quality)))

    @property
    def poses(self) -> tuple[Pose, ...]:
        return self.plan.poses

    @property
    def library(self) -> LibraryPlan | None:
        """The library, if it serves any pose."""
        return next(iter(self.libraries.values()), None)

    @property
    def sources(self) -> dict[str, PoseSource]:
        """What the poses follow from, by key."""
        solves = {solve.key: solve for solve in self.plan.solves}
        return solves | {library.key: library for library in self.libraries.values()}

    def source_keys(self) -> set[str]:
        """Return the keys of what poses follow from; those without contact follow from nothing."""
        solved = {self.plan.solve_key(index) for index in self.plan.placements}
        return solved | {library.key for library in self.libraries.values()}

    def state(
        self, index: int, solutions: Mapping[str, Any], half_extent_mm: tuple[float, float]
    ) -> PoseState:
        """Return the membrane of a pose from what its source is served by, which has the source's key."""
        if index in self.libraries:
            library: PoseLibrary = solutions[self.libraries[index].key]
            return library.state(self.plan.elastomer, self.poses[index], half_extent_mm)
        return self.plan.state(index, solutions, half_extent_mm)

    def part(self, start: int, stop: int) -> "Contacts":
        """Return the contacts of some frames."""
        frames = range(start, min(stop, len(self.poses)))
        placements = self.plan.placements
        plan = replace(
            self.plan,
            poses=self.poses[start:stop],
            placements={index - start: placements[index] for index in frames if index in placements},
        )
        libraries = self.libraries
        return Contacts(plan, {index - start: libraries[index] for index in frames if index in libraries})


@dataclass(frozen=True)
class FrameBatch:
    """Some frames, from `start` on, of every domain that shows these same contacts: one task, one shard per domain.

    `solve_keys` name the solves and the library that the contacts follow from.
    """

    recipes: tuple[DomainRecipe, ...]
    shard: str
    start: int
    contacts: Contacts = field(repr=False)
    solve_keys: tuple[str, ...]

    @property
    def key(self) -> str:
        """A hash of what the batch makes."""
        content = [[recipe.key for recipe in self.recipes], self.start, len(self), list(self.solve_keys)]
        return sha256(canonical_json(content))

    def __len__(self) -> int:
        return len(self.contacts.poses)


@dataclass(frozen=True)
class GenerationPlan:
    """Batches of frames, and by key what they wait for: solves, and libraries of poses, which are made of some."""

    recipes: tuple[DomainRecipe, ...]
    sources: dict[str, PoseSource] = field(repr=False)
    batches: tuple[FrameBatch, ...] = field(repr=False)

    @cached_property
    def solves(self) -> dict[str, Solve]:
        """All solves, those of libraries among them, by the hash of their physics."""
        return {solve.key: solve for source in self.sources.values() for solve in source.solves}

    @property
    def frames(self) -> int:
        """Labelled pictures that will be written."""
        return sum(len(batch) * len(batch.recipes) for batch in self.batches)

    @property
    def shards(self) -> int:
        return sum(len(batch.recipes) for batch in self.batches)

    def processes(self, wanted: int | None) -> int:
        """Return how many local processes share the work, by default one per core; none of them without any."""
        return min(wanted or len(os.sched_getaffinity(0)), max(len(self.solves), len(self.batches), 1))

    def without(self, finished: Mapping[str, set[str]]) -> "GenerationPlan":
        """Return what is left to do where some shards are finished, by the name of the domain."""
        batches = []
        for batch in self.batches:
            recipes = tuple(
                recipe for recipe in batch.recipes if batch.shard not in finished.get(recipe.name, ())
            )
            if recipes:
                batches.append(replace(batch, recipes=recipes))
        needed = {key for batch in batches for key in batch.solve_keys}
        sources = {key: source for key, source in self.sources.items() if key in needed}
        return replace(self, sources=sources, batches=tuple(batches))


def shard_starts(frames: int) -> range:
    """Return the first frame of each shard of a domain."""
    return range(0, frames, FRAMES_PER_SHARD)


def plan_generation(recipes: Sequence[DomainRecipe]) -> GenerationPlan:
    """Plan the generation of domains.

    Work is shared by construction: solves are keyed by their physics, and domains with the same contacts, whatever
    their light and markers, are made by the same batches.

    Raises
    ------
    ValueError
        If a contact cannot be solved.
    """
    alike: dict[tuple[Any, ...], list[DomainRecipe]] = {}
    for recipe in recipes:
        poses = recipe.solved_path(), recipe.quality, recipe.interpolated, recipe.library_reach_mm
        same = (recipe.elastomer, recipe.indenters, *poses)
        alike.setdefault(same, []).append(recipe)
    sources: dict[str, PoseSource] = {}
    batches = []
    for (elastomer, indenters, path, quality, interpolated, reach_mm), members in alike.items():
        if interpolated:
            contacts = Contacts.interpolated(elastomer, indenters[0], path, quality, reach_mm)
        else:
            plan = joined([plan_solves(elastomer, indenter, path, quality) for indenter in indenters])
            contacts = Contacts(plan)
        sources |= contacts.sources
        for number, start in enumerate(shard_starts(len(contacts.poses))):
            part = contacts.part(start, start + FRAMES_PER_SHARD)
            serving = part.source_keys()
            keys = tuple(key for key in contacts.sources if key in serving)
            batches.append(FrameBatch(tuple(members), shard_name(number), start, part, keys))
    return GenerationPlan(tuple(recipes), sources, tuple(batches))
