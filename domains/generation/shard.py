"""From contacts to shards: what a worker does with a batch of frames. Imports neither torch nor colour-science."""

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from gelgap.assets.checksums import canonical_json, sha256
from gelgap.domains.domain import random_stream
from gelgap.domains.formats.domain_folder import shard_name
from gelgap.domains.formats.pictures import encode_png, without_markers
from gelgap.domains.formats.shards import (
    LABELS,
    OPTIONAL,
    Contact,
    View,
    encode_shard,
    picture_cell,
)
from gelgap.domains.frames.splits import PARTS, draw_parts
from gelgap.domains.recipe import DomainRecipe
from gelgap.render import Illumination, Sensor, view_half_extent_mm

if TYPE_CHECKING:
    from gelgap.domains.generation.contacts import LibraryPoses
    from gelgap.render import MembraneRenderer
    from gelgap.sim import MembraneState, Pose, SolvePlan

Row = dict[str, Any]
# One renderer holds the light of the undeformed membrane, some 0.2 MB for three LEDs.
KEPT_RENDERERS = 32


@dataclass(frozen=True)
class FrameBatch:
    """The frames start…stop of every domain that shows these same contacts: one task, one shard per domain.

    `contacts` says which solve serves each of these frames, counted from `start`, or which library of poses.
    """

    recipes: tuple[DomainRecipe, ...]
    number: int
    start: int
    stop: int
    contacts: "SolvePlan | LibraryPoses" = field(repr=False)
    solve_keys: tuple[str, ...]

    @property
    def shard(self) -> str:
        return shard_name(self.number)

    @property
    def key(self) -> str:
        """A hash of what the batch makes."""
        content = [[recipe.key for recipe in self.recipes], self.start, self.stop, list(self.solve_keys)]
        return sha256(canonical_json(content))

    def __len__(self) -> int:
        return self.stop - self.start


@dataclass(frozen=True)
class Shard:
    """One encoded shard, with what the manifest says of it; `unrenderable` says why a frame has no picture.

    `interpolation` tells the errors of the library that its poses are from, if they are.
    """

    domain: str
    file: str
    data: bytes
    facts: dict[str, Any]
    unrenderable: dict[int, str]
    interpolation: dict[str, Any] | None = None


def render_batch(batch: FrameBatch, solutions: dict[str, Any]) -> list[Shard]:
    """Render a batch's frames in the light of each of its domains, and encode one shard per domain.

    `solutions` holds the batch's solves, or its library of poses, by key. A frame whose membrane cannot be rendered,
    whatever goes wrong, is flagged as not converged; if that happens to most of several frames, something else is
    wrong: a RuntimeError.
    """
    groups = group_by_picture(batch.recipes)
    shards: dict[int, Shard] = {}
    # Contacts are the inner loop as long as the renderers of the outer one are kept.
    for start in range(0, len(groups), KEPT_RENDERERS):
        shards |= _shards_of_groups(groups[start : start + KEPT_RENDERERS], batch, solutions)
    libraries = (source for source in solutions.values() if hasattr(source, "errors"))
    interpolation = next((library.errors for library in libraries if library.held_out is not None), None)
    return [replace(shards[index], interpolation=interpolation) for index in range(len(batch.recipes))]


def group_by_picture(recipes: Sequence[DomainRecipe]) -> list[list[int]]:
    """Return the indices of the recipes in groups whose pictures are one rendering, inpainted or not."""
    groups: dict[Hashable, list[int]] = {}
    for index, recipe in enumerate(recipes):
        light = (recipe.sensor, recipe.illumination, recipe.size_px, recipe.render_quality)
        rendering = (recipe.picture_name, recipe.seed, _shows_markers(recipe), *light)
        groups.setdefault(rendering, []).append(index)
    return list(groups.values())


def _shards_of_groups(
    groups: Sequence[Sequence[int]], batch: FrameBatch, solutions: dict[str, Any]
) -> Iterator[tuple[int, Shard]]:
    """Yield (recipe, shard). Contact by contact, so that a membrane is rastered once for all lights that fall on it.

    Cameras with the same extent of view share their membranes, whose grid it decides.
    """
    from gelgap.sim import traction_map

    recipes, physics = batch.recipes, batch.contacts
    rows: dict[int, list[Row]] = {index: [] for members in groups for index in members}
    label_cells = {index: _label_cells_of(recipes[index]) for index in rows}
    unrenderable: list[dict[int, str]] = [{} for _ in groups]
    cameras = [(recipes[members[0]].sensor.camera, recipes[members[0]].size_px) for members in groups]
    extents = [view_half_extent_mm(*camera) for camera in cameras]
    for place, frame in enumerate(range(batch.start, batch.stop)):
        solution = solutions.get(physics.solve_key(place))
        states = {extent: physics.state(place, solution, extent) for extent in set(extents)}
        for members, refused, extent in zip(groups, unrenderable, extents, strict=True):
            own, state = [recipes[index] for index in members], states[extent]
            cells: list[Row] = [{"image": None, "converged": False} for _ in own]
            if state.converged:
                try:
                    coarse_n = None
                    if any("traction" in recipe.columns for recipe in own):
                        coarse_n = traction_map(physics, place, solution, state).coarse_n(
                            half_extent_mm=extent
                        )
                    cells = picture_cells(own, frame, state, coarse_n)
                except (MemoryError, OSError):
                    raise  # the machine's trouble, not this frame's
                except Exception as error:
                    # Only a sentence of our own speaks for itself.
                    is_ours = isinstance(error, ValueError)
                    refused[frame] = str(error) if is_ours else f"{type(error).__name__}: {error}"
            for index, own_cells in zip(members, cells, strict=True):
                rows[index].append(label_cells[index](frame, state) | own_cells)
    for members, refused in zip(groups, unrenderable, strict=True):
        if len(refused) > max(len(batch) / 2, 1):
            frame, reason = next(iter(refused.items()))
            raise RuntimeError(
                f"domain {recipes[members[0]].name}: {len(refused)} of {len(batch)} frames cannot be rendered; "
                f"frame {frame}: {reason}"
            )
        for index in members:
            yield index, _shard(recipes[index], batch.shard, rows[index], refused)


def picture_cells(
    recipes: Sequence[DomainRecipe],
    frame: int,
    state: "MembraneState",
    coarse_n: np.ndarray | None = None,
) -> list[dict[str, Any]]:
    """Return the picture columns of one contact for recipes that are one group of `group_by_picture`, rendered once."""
    first = recipes[0]
    renderer = renderer_of(first)
    view = View(renderer, first.sensor, state, coarse_n)
    picture = renderer.picture(
        *view.membrane,
        markers=_shows_markers(first),
        rng=random_stream(first.seed, first.picture_name, "sensor noise", frame),
        frame_name=f"frame {frame} of {first.name}",
    )
    return [
        {"image": picture_cell(_as_shown(recipe, picture))}
        | {
            column.name: column.cell(view)
            for name in recipe.columns
            for column in OPTIONAL[name]
            if column.cell
        }
        for recipe in recipes
    ]


def reference_png(recipe: DomainRecipe) -> bytes:
    """Return a domain's picture without contact."""
    renderer = renderer_of(recipe)
    rng = random_stream(recipe.seed, recipe.picture_name, "reference noise")
    return encode_png(_as_shown(recipe, renderer.reference(markers=_shows_markers(recipe), rng=rng)))


def renderer_of(recipe: DomainRecipe) -> "MembraneRenderer":
    """Return what renders the pictures of a domain; it is kept for other domains of the same light and camera."""
    return _renderer(recipe.sensor, recipe.illumination, recipe.size_px, recipe.render_quality)


@lru_cache(maxsize=KEPT_RENDERERS)
def _renderer(
    sensor: Sensor, illumination: Illumination, size_px: tuple[int, int], quality: str
) -> "MembraneRenderer":
    from gelgap.render import MembraneRenderer

    return MembraneRenderer(sensor, illumination, size_px, quality)


def _shows_markers(recipe: DomainRecipe) -> bool:
    return recipe.markers or recipe.inpainted_from is not None


def _as_shown(recipe: DomainRecipe, picture: np.ndarray) -> np.ndarray:
    """Return the picture, without its markers if the recipe has them inpainted."""
    return picture if recipe.inpainted_from is None else without_markers(picture)


@lru_cache(maxsize=8)
def _label_cells_of(recipe: DomainRecipe) -> "Callable[[int, MembraneState], Row]":
    """Return what makes the label columns of one frame; what does not depend on the frame is found once."""
    optional = (column for name in recipe.columns for column in OPTIONAL[name])
    columns = (*LABELS, *(column for column in optional if column.value))
    poses, travels = recipe.commanded_poses(), trajectories(recipe.path.poses)
    split = draw_parts(recipe.frames, recipe.seed)
    last_travel = max(number for number, _ in travels) + 1
    bias_n, noise_n = recipe.drawn_errors().force_bias_n, recipe.acquisition.force_noise_n

    def cells(frame: int, state: "MembraneState") -> Row:
        force_n = np.asarray(state.force_n, float) + bias_n
        if noise_n:
            rng = random_stream(recipe.seed, recipe.picture_name, "force noise", frame)
            force_n = force_n + noise_n * rng.standard_normal(3)
        # Adding zero turns −0.0, which some readers show, into 0.0.
        force_n = tuple(float(value) + 0.0 for value in force_n)
        turn, place = divmod(frame, len(poses))
        (travel, step), indenter = travels[place], recipe.indenters[turn]
        travel += turn * last_travel
        contact = Contact(
            frame, poses[place], travel, step, PARTS[split[frame]], state, force_n, indenter.label
        )
        return {column.name: column.value(contact) for column in columns}

    return cells


def trajectories(poses: "Sequence[Pose]") -> list[tuple[int, int]]:
    """Return (trajectory, step) of each frame: the path's, or the travel at one point, depth and direction."""
    numbers: dict[tuple, int] = {}
    steps: dict[int, int] = {}
    found = []
    for pose in poses:
        travel = (pose.point_id, pose.depth_mm, pose.angle_deg if pose.radius_mm else -1.0)
        if pose.trajectory is not None:
            travel = ("trajectory", pose.trajectory)
        number = numbers.setdefault(travel, len(numbers))
        steps[number] = steps.get(number, -1) + 1
        found.append((number, steps[number]))
    return found


def _shard(recipe: DomainRecipe, file: str, rows: list[Row], unrenderable: dict[int, str]) -> Shard:
    forces = np.array([[row["fx_n"], row["fy_n"], row["fz_n"]] for row in rows if row["converged"]])
    forces = forces.reshape(-1, 3)
    low, high = np.array(recipe.force_range_n).T
    facts = {
        "frames": len(rows),
        "unconverged": len(rows) - len(forces),
        "force_min_n": forces.min(axis=0).tolist() if len(forces) else None,
        "force_max_n": forces.max(axis=0).tolist() if len(forces) else None,
        "outside_range": int(((forces < low) | (forces > high)).any(axis=1).sum()),
    }
    return Shard(recipe.name, file, encode_shard(rows, recipe.columns), facts, unrenderable)
