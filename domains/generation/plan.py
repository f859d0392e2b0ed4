"""What has to be done for a set of domains: distinct solves, batches of frames, each once; and what that takes."""

import logging
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gelgap.assets.names import comma_list
from gelgap.domains.generation.contacts import LibraryPoses, part_of
from gelgap.domains.generation.shard import FrameBatch, picture_cells
from gelgap.domains.recipe import DomainRecipe

if TYPE_CHECKING:
    from gelgap.domains.library import LibraryPlan
    from gelgap.sim import MembraneState, Solve

LOG = logging.getLogger(__name__)
FRAMES_PER_SHARD = 128
# Seconds of a core of a server of 2023: the start of a process, a frame.
_START_S = 4.0
_FRAME_S, _FRAME_PIXEL_S = 0.006, 1e-7
# A range that is proposed is wider than the force that is expected, by what the expectation may be short of.
_ROOM_FOR_FORCE = 1.5


@dataclass(frozen=True)
class GenerationPlan:
    """Solves by the hash of their physics, libraries of poses that are made of some, and batches that wait for them."""

    recipes: tuple[DomainRecipe, ...]
    solves: "dict[str, Solve]" = field(repr=False)
    batches: tuple[FrameBatch, ...] = field(repr=False)
    libraries: "dict[str, LibraryPlan]" = field(default_factory=dict, repr=False)

    @property
    def frames(self) -> int:
        """Labelled pictures that will be written."""
        return sum(len(batch) * len(batch.recipes) for batch in self.batches)

    def processes(self, wanted: int | None) -> int:
        """Return how many local processes share the work, by default one per core; none of them without any."""
        return min(wanted or len(os.sched_getaffinity(0)), max(len(self.solves), len(self.batches), 1))

    def without(self, finished: Mapping[str, set[str]]) -> "GenerationPlan":
        """Return what is left to do where some shards are finished, by the name of the domain."""
        batches = []
        for batch in self.batches:
            recipes = tuple(own for own in batch.recipes if batch.shard not in finished.get(own.name, ()))
            if recipes:
                batches.append(replace(batch, recipes=recipes))
        needed = dict.fromkeys(key for batch in batches for key in batch.solve_keys)
        libraries = {key: library for key, library in self.libraries.items() if key in needed}
        needed |= dict.fromkeys(solve.key for library in libraries.values() for solve in library.solves)
        solves = {key: solve for key, solve in self.solves.items() if key in needed}
        return GenerationPlan(self.recipes, solves, tuple(batches), libraries)


def shard_bounds(frames: int) -> list[tuple[int, int]]:
    """Return the first frame of each shard of a domain, and the one after its last."""
    return [(start, min(start + FRAMES_PER_SHARD, frames)) for start in range(0, frames, FRAMES_PER_SHARD)]


def plan_generation(recipes: Sequence[DomainRecipe]) -> GenerationPlan:
    """Plan the generation of domains.

    Work is shared by construction: solves are keyed by their physics, and domains with the same contacts, whatever
    their light and markers, are made by the same batches.

    Raises
    ------
    ValueError
        If a contact cannot be solved.
    """
    from gelgap.sim import joined, plan_solves

    alike: dict[tuple[Any, ...], list[DomainRecipe]] = {}
    for recipe in recipes:
        same = (recipe.elastomer, recipe.indenters, recipe.solved_path(), recipe.quality, recipe.interpolated)
        alike.setdefault(same, []).append(recipe)
    solves: dict[str, Solve] = {}
    libraries: dict[str, LibraryPlan] = {}
    batches = []
    for (elastomer, indenters, *contacts, interpolated), members in alike.items():
        if interpolated:
            physics = LibraryPoses.of(elastomer, indenters[0], *contacts)
        else:
            physics = joined([plan_solves(elastomer, indenter, *contacts) for indenter in indenters])
        by_key: dict[str, Any] = {solve.key: solve for solve in physics.solves}
        if isinstance(physics, LibraryPoses):
            libraries[physics.library.key] = by_key[physics.library.key] = physics.library
            solves |= {solve.key: solve for solve in physics.library.solves}
        for number, (start, stop) in enumerate(shard_bounds(len(physics.poses))):
            serving = {physics.solve_key(frame) for frame in range(start, stop)}
            keys = tuple(key for key in by_key if key in serving)
            solves |= {key: by_key[key] for key in keys if key not in libraries}
            own = part_of(physics, start, stop)
            batches.append(FrameBatch(tuple(members), number, start, stop, own, keys))
    return GenerationPlan(tuple(recipes), solves, tuple(batches), libraries)


@dataclass(frozen=True)
class Estimate:
    """The size of a plan; `contacts` is what would be solved if nothing were shared.

    `wall_s` is the time on an idle machine whose cores are like a server's of 2023. `exact` is the estimate of the same
    domains with each pose solved, None where they are so anyway.
    """

    domains: tuple[str, ...]
    frames: int
    shards: int
    contacts: int
    solves: int
    solves_cached: int
    wall_s: float
    disk_bytes: float
    workers: int
    indenters: tuple[str, ...] = ()
    """What the solves of each indenter take, if they are not all of one sphere."""
    notes: tuple[str, ...] = ()
    exact: "Estimate | None" = None

    @property
    def wall(self) -> str:
        return f"{self.wall_s:.0f} s" if self.wall_s < 90 else f"{self.wall_s / 60:.0f} min"

    def __str__(self) -> str:
        kilobytes = self.disk_bytes / self.frames / 1e3
        by_itself = []
        if self.exact:
            by_itself = [
                "library  poses are interpolated, at most two solves more where its error is too large; each solved "
                f"by itself (--exact): {self.exact.solves} solves, about {self.exact.wall}"
            ]
        return "\n".join(
            [
                f"domains  {comma_list(self.domains)}",
                f"frames   {self.frames} in {self.shards} shards",
                f"solves   {self.solves} for {self.contacts} contacts, {self.solves_cached} already known",
                *by_itself,
                f"time     about {self.wall} with {self.workers} workers",
                f"disk     about {self.disk_bytes / 1e6:.0f} MB ({kilobytes:.1f} kB per frame)",
                *(f"indenter {line}" for line in self.indenters),
                *(f"note     {note}" for note in self.notes),
            ]
        )


def estimate(recipes: Sequence[DomainRecipe], workers: int | None = None) -> Estimate:
    """Plan domains and estimate their cost; one frame is rendered for it.

    Raises
    ------
    ValueError
        If workers is below 1, or a contact cannot be solved.
    """
    from gelgap.sim import has_solution

    if workers is not None and workers < 1:
        raise ValueError(f"workers = {workers}: must be 1 or more")
    LOG.info("planning and rendering a sample frame of %s", comma_list([recipe.name for recipe in recipes]))
    plan = plan_generation(recipes)
    processes = plan.processes(workers)
    shards = sum(len(batch.recipes) for batch in plan.batches)
    to_solve = {key: solve for key, solve in plan.solves.items() if not has_solution(key)}
    solve_s = [solve.expected_core_s for solve in to_solve.values()]
    pixels = max(recipe.size_px[0] * recipe.size_px[1] for recipe in recipes)
    # One solve is not shared; frames are shared as shards.
    solving_s = max(sum(solve_s) / processes, *solve_s, 0.0)
    rendering_s = (_FRAME_S + _FRAME_PIXEL_S * pixels) * plan.frames / min(processes, shards or 1)
    (sample,) = picture_cells(recipes[:1], 0, _dent())
    frame_bytes = sum(len(cell["bytes"]) for cell in sample.values() if isinstance(cell, dict))
    exact = [recipe.model_copy(update={"interpolated": False}) for recipe in recipes]
    return Estimate(
        domains=tuple(recipe.name for recipe in recipes),
        frames=plan.frames,
        shards=shards,
        contacts=len(
            {
                (r.elastomer, indenter, pose)
                for r in recipes
                for indenter in r.indenters
                for pose in r.solved_path().poses
                if pose.depth_mm > 0
            }
        ),
        solves=len(plan.solves),
        solves_cached=len(plan.solves) - len(to_solve),
        wall_s=_START_S + solving_s + rendering_s,
        disk_bytes=frame_bytes * plan.frames,
        workers=processes,
        indenters=_by_indenter(plan),
        notes=tuple(force_notes(recipes)),
        exact=estimate(exact, workers) if plan.libraries else None,
    )


def _by_indenter(plan: GenerationPlan) -> tuple[str, ...]:
    """Return what the solves of each indenter take and share, if they are not all of one sphere."""
    from gelgap.sim import Symmetry

    shared = {
        Symmetry.REVOLUTION: "all directions share solves",
        Symmetry.MIRROR: "only mirrored directions share solves",
        Symmetry.NONE: "no directions share solves",
    }
    by_label: dict[str, list[Solve]] = {}
    shares: dict[str, str] = {}
    for solve in plan.solves.values():
        problem = solve.problem
        label, share = problem.indenter.label, shared[problem.indenter.symmetry]
        if problem.turns_deg:
            label, share = f"{label}, turning", "what turns shares solves only where it all is the same"
        by_label.setdefault(label, []).append(solve)
        shares[label] = share
    if len(by_label) == 1 and next(iter(by_label)).startswith("sphere") and not problem.turns_deg:
        return ()
    return tuple(
        f"{label}: {len(own)} solves, {sum(solve.expected_core_s for solve in own):.0f} s of a core; {shares[label]}"
        for label, own in by_label.items()
    )


def force_notes(recipes: Sequence[DomainRecipe]) -> list[str]:
    """Return which domains will probably have forces outside their declared range, in sentences; nothing is solved."""
    from gelgap.sim import expected_force_n

    expected_n: dict[str, float] = {}
    for recipe in recipes:
        deepest_mm = max(pose.depth_mm for pose in recipe.path.poses)
        force_n = expected_force_n(recipe.elastomer, recipe.indenter, deepest_mm)
        if force_n > -recipe.force_range_n[2][0]:
            expected_n[recipe.name] = force_n
    if not expected_n:
        return []
    name, force_n = max(expected_n.items(), key=lambda item: item[1])
    (declared_n,) = {recipe.force_range_n[2][0] for recipe in recipes if recipe.name == name}
    others = f" (and {len(expected_n) - 1} other domains)" if len(expected_n) > 1 else ""
    wide = math.ceil(_ROOM_FOR_FORCE * force_n)
    return [
        f"the deepest press of {name}{others} takes about {force_n:.3g} N, beyond the declared Fz = {declared_n:g} N: "
        "training refuses such frames; declare a wider range, as "
        f"--force-range fx_n=-{wide}:{wide} fy_n=-{wide}:{wide} fz_n=-{wide}:0"
    ]


def _dent() -> "MembraneState":
    """Return a membrane that looks like a contact to the renderer; no physics."""
    from gelgap.sim import MembraneState, grid_axes

    x_mm, y_mm = grid_axes()
    distance2 = x_mm[None, :] ** 2 + y_mm[:, None] ** 2
    displacement = np.zeros((len(y_mm), len(x_mm), 3), np.float32)
    displacement[..., 2] = -0.6 * np.exp(-distance2)
    return MembraneState(x_mm, y_mm, displacement, distance2 < 0.5, np.zeros(3))
