"""From contacts to shards: what a worker does with a batch of frames. Imports neither torch nor colour-science."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from gelgap.domains.columns import LABELS, OPTIONAL, LabelColumn, LabelSource
from gelgap.domains.frame_pictures import KEPT_RENDERERS, group_by_picture, picture_cells
from gelgap.domains.plan import FrameBatch, solve_plan
from gelgap.domains.random_streams import random_stream
from gelgap.domains.recipe import DomainRecipe
from gelgap.domains.schema import encode_shard
from gelgap.domains.splits import PARTS, draw_parts
from gelgap.render import view_half_extent_mm
from gelgap.sim import Pose

if TYPE_CHECKING:
    from gelgap.sim import MembraneState

Row = dict[str, Any]


@dataclass(frozen=True)
class Shard:
    """One encoded shard, with what the manifest says of it; `unrenderable` says why a frame has no picture."""

    domain: str
    file: str
    data: bytes
    frames: int
    unconverged: int
    unrenderable: dict[int, str]
    force_min_n: tuple[float, ...] | None
    force_max_n: tuple[float, ...] | None
    outside_range: int


def render_batch(batch: FrameBatch, matrices: Sequence[np.ndarray], solutions: dict[str, Any]) -> list[Shard]:
    """Render a batch's frames in the light of each of its domains, and encode one shard per domain.

    `matrices` holds each domain's LED-to-camera matrix, `solutions` the batch's solves by key. A frame whose membrane
    cannot be rendered, whatever goes wrong, is flagged as not converged.

    Raises
    ------
    RuntimeError
        If that happens to most of several frames: then something else is wrong.
    MemoryError, OSError
        If the machine cannot go on.
    """
    groups = group_by_picture(batch.recipes)
    shards: list[Shard | None] = [None] * len(batch.recipes)
    # Contacts are the inner loop as long as the renderers of the outer one are kept.
    for start in range(0, len(groups), KEPT_RENDERERS):
        kept = groups[start : start + KEPT_RENDERERS]
        for index, shard in _shards_of_groups(kept, batch, matrices, solutions):
            shards[index] = shard
    return shards


def _shards_of_groups(
    groups: Sequence[Sequence[int]],
    batch: FrameBatch,
    matrices: Sequence[np.ndarray],
    solutions: dict[str, Any],
) -> Iterator[tuple[int, Shard]]:
    """Yield (recipe, shard). Contact by contact, so that a membrane is rastered once for all lights that fall on it.

    Cameras with the same extent of view share their membranes, whose grid it decides.
    """
    physics = solve_plan(batch.recipes[0])
    rows: dict[int, list[Row]] = {index: [] for members in groups for index in members}
    labels = {index: _Labels.of(batch.recipes[index]) for index in rows}
    unrenderable: list[dict[int, str]] = [{} for _ in groups]
    extents = [_view_half_extent_mm(batch.recipes[members[0]]) for members in groups]
    for frame in range(batch.start, batch.stop):
        solution = solutions.get(physics.solve_key(frame))
        states = {extent: physics.state(frame, solution, extent) for extent in set(extents)}
        for members, refused, extent in zip(groups, unrenderable, extents, strict=True):
            recipes, state = [batch.recipes[index] for index in members], states[extent]
            cells: list[Row] = [{"image": None, "converged": False} for _ in recipes]
            if state.converged:
                try:
                    cells = picture_cells(recipes, matrices[members[0]], frame, state)
                except (MemoryError, OSError):
                    raise  # the machine's trouble, not this frame's
                except Exception as error:
                    refused[frame] = _reason(error)
            for index, own_cells in zip(members, cells, strict=True):
                rows[index].append(labels[index].row(frame, state) | own_cells)
    for members, refused in zip(groups, unrenderable, strict=True):
        if len(refused) > max(len(batch) / 2, 1):
            frame, reason = next(iter(refused.items()))
            raise RuntimeError(
                f"domain {batch.recipes[members[0]].name}: {len(refused)} of {len(batch)} frames cannot be rendered; "
                f"frame {frame}: {reason}"
            )
        for index in members:
            yield index, _shard(batch.recipes[index], batch.shard, rows[index], refused)


def _view_half_extent_mm(recipe: DomainRecipe) -> tuple[float, float]:
    return view_half_extent_mm(recipe.sensor.camera, recipe.size_px)


def _reason(error: Exception) -> str:
    """Return why a frame was not rendered; only a sentence of our own speaks for itself."""
    return str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}"


@dataclass(frozen=True)
class _Labels:
    """The labels of one domain's frames: what does not depend on the frame is found once."""

    recipe: DomainRecipe
    columns: tuple[LabelColumn, ...]
    poses: tuple[Pose, ...]
    trajectories: tuple[tuple[int, int], ...]
    split: tuple[str, ...]
    force_bias_n: tuple[float, float, float]

    @classmethod
    def of(cls, recipe: DomainRecipe) -> Self:
        optional = (column for name in recipe.columns for column in OPTIONAL[name])
        return cls(
            recipe=recipe,
            columns=(*LABELS, *(column for column in optional if isinstance(column, LabelColumn))),
            poses=_commanded(recipe),
            trajectories=_trajectories(recipe),
            split=_split(len(recipe.path.poses), recipe.seed),
            force_bias_n=recipe.drawn_errors().force_bias_n,
        )

    def row(self, frame: int, state: "MembraneState") -> Row:
        trajectory, step = self.trajectories[frame]
        source = LabelSource(
            frame=frame,
            pose=self.poses[frame],
            trajectory=trajectory,
            step=step,
            split=self.split[frame],
            state=state,
            force_n=self._measured_force_n(frame, state),
        )
        return {column.name: column.value(source) for column in self.columns}

    def _measured_force_n(self, frame: int, state: "MembraneState") -> tuple[float, float, float]:
        recipe, force = self.recipe, np.asarray(state.force_n, float) + self.force_bias_n
        if recipe.acquisition.force_noise_n:
            rng = random_stream(recipe.seed, recipe.picture_name, "force noise", frame)
            force = force + recipe.acquisition.force_noise_n * rng.standard_normal(3)
        # Adding zero turns −0.0, which some readers show, into 0.0.
        return tuple(float(value) + 0.0 for value in force)


@lru_cache(maxsize=8)
def _commanded(recipe: DomainRecipe) -> tuple[Pose, ...]:
    return recipe.commanded_poses()


@lru_cache(maxsize=8)
def _trajectories(recipe: DomainRecipe) -> tuple[tuple[int, int], ...]:
    """Return (trajectory, step) of each frame: the path's, or the travel at one point, depth and direction."""
    numbers: dict[tuple, int] = {}
    steps: dict[int, int] = {}
    found = []
    for pose in recipe.path.poses:
        travel = (pose.point_id, pose.depth_mm, pose.angle_deg if pose.radius_mm else -1.0)
        if pose.trajectory is not None:
            travel = ("trajectory", pose.trajectory)
        number = numbers.setdefault(travel, len(numbers))
        steps[number] = steps.get(number, -1) + 1
        found.append((number, steps[number]))
    return tuple(found)


@lru_cache(maxsize=8)
def _split(frames: int, seed: int) -> tuple[str, ...]:
    return tuple(PARTS[part] for part in draw_parts(frames, seed))


def _shard(recipe: DomainRecipe, file: str, rows: list[Row], unrenderable: dict[int, str]) -> Shard:
    forces = np.array([[row["fx_n"], row["fy_n"], row["fz_n"]] for row in rows if row["converged"]])
    forces = forces.reshape(-1, 3)
    low, high = np.array(recipe.force_range_n).T
    return Shard(
        domain=recipe.name,
        file=file,
        data=encode_shard(rows, recipe.columns),
        frames=len(rows),
        unconverged=len(rows) - len(forces),
        unrenderable=unrenderable,
        force_min_n=tuple(forces.min(axis=0).tolist()) if len(forces) else None,
        force_max_n=tuple(forces.max(axis=0).tolist()) if len(forces) else None,
        outside_range=int(((forces < low) | (forces > high)).any(axis=1).sum()),
    )
