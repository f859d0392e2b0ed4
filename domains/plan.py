"""What has to be done for a set of domains: distinct solves, and batches of frames, each once."""

import hashlib
import os
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

from gelgap.assets.checksums import canonical_json
from gelgap.domains.folder import shard_name
from gelgap.domains.recipe import DomainRecipe
from gelgap.sim import ContactPath, Elastomer, PosePath, Sphere

if TYPE_CHECKING:
    from gelgap.sim import Solve, SolvePlan

FRAMES_PER_SHARD = 128


@dataclass(frozen=True)
class FrameBatch:
    """The frames start…stop of every domain that shows these same contacts: one task, one shard per domain."""

    recipes: tuple[DomainRecipe, ...]
    number: int
    start: int
    stop: int
    solve_keys: tuple[str, ...]

    @property
    def shard(self) -> str:
        return shard_name(self.number)

    @property
    def key(self) -> str:
        """A hash of what the batch makes."""
        content = [[recipe.key for recipe in self.recipes], self.start, self.stop, list(self.solve_keys)]
        return hashlib.sha256(canonical_json(content)).hexdigest()

    def __len__(self) -> int:
        return self.stop - self.start


@dataclass(frozen=True)
class GenerationPlan:
    """Solves by the hash of their physics, and the batches that wait for them."""

    recipes: tuple[DomainRecipe, ...]
    solves: "dict[str, Solve]" = field(repr=False)
    batches: tuple[FrameBatch, ...] = field(repr=False)

    @property
    def frames(self) -> int:
        """Labelled pictures that will be written."""
        return sum(len(batch) * len(batch.recipes) for batch in self.batches)

    def processes(self, wanted: int | None) -> int:
        """Return how many local processes share the work, by default one per core; none of them without any."""
        return min(wanted or len(os.sched_getaffinity(0)), max(len(self.solves), len(self.batches), 1))


def shard_bounds(frames: int) -> list[tuple[int, int]]:
    """Return the first frame of each shard of a domain, and the one after its last."""
    return [(start, min(start + FRAMES_PER_SHARD, frames)) for start in range(0, frames, FRAMES_PER_SHARD)]


def plan_generation(
    recipes: Sequence[DomainRecipe], finished: dict[str, set[str]] | None = None
) -> GenerationPlan:
    """Plan the generation of domains, leaving out shards that are `finished` (by domain name).

    Work is shared by construction: solves are keyed by their physics, and domains with the same contacts, whatever
    their light and markers, are made by the same batches.
    """
    finished = finished or {}
    alike: dict[Hashable, list[DomainRecipe]] = {}
    for recipe in recipes:
        contacts = (recipe.elastomer, recipe.indenter, recipe.quality, recipe.solved_path())
        alike.setdefault(contacts, []).append(recipe)
    solves: dict[str, Solve] = {}
    batches = []
    for members in alike.values():
        physics = solve_plan(members[0])
        by_key = {solve.key: solve for solve in physics.solves}
        for number, (start, stop) in enumerate(shard_bounds(len(members[0].path.poses))):
            wanting = tuple(
                recipe for recipe in members if shard_name(number) not in finished.get(recipe.name, ())
            )
            if not wanting:
                continue
            serving = {physics.solve_key(frame) for frame in range(start, stop)}
            keys = tuple(key for key in by_key if key in serving)
            solves |= {key: by_key[key] for key in keys}
            batches.append(FrameBatch(wanting, number, start, stop, keys))
    return GenerationPlan(tuple(recipes), solves, tuple(batches))


def solve_plan(recipe: DomainRecipe) -> "SolvePlan":
    """Return which solve serves which frame of a domain."""
    return _solve_plan(recipe.elastomer, recipe.indenter, recipe.solved_path(), recipe.quality)


@lru_cache(maxsize=8)
def _solve_plan(
    elastomer: Elastomer, indenter: Sphere, path: ContactPath | PosePath, quality: str
) -> "SolvePlan":
    from gelgap.sim import plan_solves

    return plan_solves(elastomer, indenter, path, quality)
