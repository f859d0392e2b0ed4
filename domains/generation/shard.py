"""From contacts to shards: what a worker does with a batch of frames. Imports neither torch nor colour-science."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from gelgap.data.formats.pictures import encode_png, without_markers
from gelgap.data.formats.shards import LABELS, OPTIONAL, Column, encode_shard, picture_cell
from gelgap.data.frames.labels import FORCE_COLUMNS
from gelgap.data.frames.splits import PARTS, draw_parts
from gelgap.data.random_stream import random_stream
from gelgap.domains.generation.columns import CELL_MAKERS, LABEL_MAKERS, Contact, View
from gelgap.domains.generation.plan import FrameBatch
from gelgap.domains.recipe import DomainRecipe
from gelgap.domains.renderers import KEPT_RENDERERS, kept_renderer, renderer_of
from gelgap.render import Illumination, Sensor
from gelgap.render.surface import view_half_extent_mm
from gelgap.sim import MembraneState, Pose
from gelgap.sim.library import LibraryPose, PoseState

Row = dict[str, Any]


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
    alike: dict[Hashable, list[DomainRecipe]] = {}
    for recipe in batch.recipes:
        # All that pictures depend on besides their contacts; they may be inpainted or not.
        light = recipe.sensor, recipe.illumination, recipe.size_px, recipe.render_quality
        rendering = recipe.picture_name, recipe.seed, _shows_markers(recipe), *light
        alike.setdefault(rendering, []).append(recipe)
    labels_of = {recipe.name: _label_cells_of(recipe) for recipe in batch.recipes}
    rows: dict[str, list[Row]] = {name: [] for name in labels_of}
    refused: dict[str, dict[int, str]] = {name: {} for name in labels_of}
    groups = list(alike.values())
    frames = range(batch.start, batch.start + len(batch))
    # A membrane is rastered once for all lights of a group; a group has as many lights as renderers are kept.
    for start, (place, frame) in product(range(0, len(groups), KEPT_RENDERERS), enumerate(frames)):
        states: dict[tuple[float, float], PoseState] = {}
        for recipes in groups[start : start + KEPT_RENDERERS]:
            # Cameras with the same extent of view share their membranes, whose grid it decides.
            extent = view_half_extent_mm(recipes[0].sensor.camera, recipes[0].size_px)
            if extent not in states:
                states[extent] = batch.contacts.state(place, solutions, extent)
            state = states[extent]
            reason: str | None = None
            cells: list[Row] = [{"image": None, "converged": False} for _ in recipes]
            if state.converged:
                try:
                    coarse_n = None
                    wants_traction = any("traction" in recipe.columns for recipe in recipes)
                    # Recipes ask no library for it.
                    if wants_traction and not isinstance(state, LibraryPose):
                        coarse_n = state.traction().coarse_n(half_extent_mm=extent)
                    cells = picture_cells(recipes, frame, state, coarse_n)
                except (MemoryError, OSError):
                    raise  # the machine's trouble, not this frame's
                except Exception as error:
                    # Only a sentence of our own speaks for itself.
                    is_ours = isinstance(error, ValueError)
                    reason = str(error) if is_ours else f"{type(error).__name__}: {error}"
            for recipe, picture in zip(recipes, cells, strict=True):
                rows[recipe.name].append(labels_of[recipe.name](frame, state) | picture)
                if reason is not None:
                    refused[recipe.name][frame] = reason
    library = batch.contacts.library
    errors = solutions[library.key].errors if library else None
    return [
        _shard(recipe, batch.shard, rows[recipe.name], refused[recipe.name], errors)
        for recipe in batch.recipes
    ]


def paper_picture(state: MembraneState) -> np.ndarray:
    """Return the picture (h, w, 3) of the paper's sensor in the light i0, by which a library's error is judged."""
    renderer = kept_renderer(Sensor.preset("paper"), Illumination.preset("i0"))
    return renderer.picture(state.x_mm, state.y_mm, state.displacement_mm).astype(float)


def _shard(
    recipe: DomainRecipe,
    file: str,
    rows: list[Row],
    refused: dict[int, str],
    interpolation: dict[str, Any] | None,
) -> Shard:
    """Return rows as a shard, or raise RuntimeError if most of several frames cannot be rendered."""
    if len(refused) > max(len(rows) / 2, 1):
        frame, reason = next(iter(refused.items()))
        raise RuntimeError(
            f"domain {recipe.name}: {len(refused)} of {len(rows)} frames cannot be rendered; frame {frame}: {reason}"
        )
    forces_n = pd.DataFrame(rows).query("converged")[[*FORCE_COLUMNS]].to_numpy()
    low, high = np.array(recipe.force_range_n).T
    facts = {
        "frames": len(rows),
        "unconverged": len(rows) - len(forces_n),
        "force_min_n": forces_n.min(axis=0).tolist() if len(forces_n) else None,
        "force_max_n": forces_n.max(axis=0).tolist() if len(forces_n) else None,
        "outside_range": int(((forces_n < low) | (forces_n > high)).any(axis=1).sum()),
    }
    return Shard(recipe.name, file, encode_shard(rows, recipe.columns), facts, refused, interpolation)


def picture_cells(
    recipes: Sequence[DomainRecipe], frame: int, state: MembraneState, coarse_n: np.ndarray | None = None
) -> list[dict[str, Any]]:
    """Return the picture columns of one contact for recipes that share their pictures, rendered once."""
    first = recipes[0]
    view = View(renderer_of(first), state, coarse_n)
    picture = view.renderer.picture(
        *view.membrane,
        markers=_shows_markers(first),
        rng=random_stream(first.seed, first.picture_name, "sensor noise", frame),
        frame_name=f"frame {frame} of {first.name}",
    )
    cells = []
    for recipe in recipes:
        chosen = [column.name for column in _optional(recipe) if not column.is_label]
        optional = {name: CELL_MAKERS[name](view) for name in chosen}
        cells.append({"image": picture_cell(_as_shown(recipe, picture))} | optional)
    return cells


def _optional(recipe: DomainRecipe) -> list[Column]:
    return [column for name in recipe.columns for column in OPTIONAL[name]]


def reference_png(recipe: DomainRecipe) -> bytes:
    """Return a domain's picture without contact."""
    rng = random_stream(recipe.seed, recipe.picture_name, "reference noise")
    picture = renderer_of(recipe).reference(markers=_shows_markers(recipe), rng=rng)
    return encode_png(_as_shown(recipe, picture))


def _shows_markers(recipe: DomainRecipe) -> bool:
    return recipe.markers or recipe.inpainted_from is not None


def _as_shown(recipe: DomainRecipe, picture: np.ndarray) -> np.ndarray:
    """Return the picture, without its markers if the recipe has them inpainted."""
    return picture if recipe.inpainted_from is None else without_markers(picture)


@lru_cache(maxsize=8)
def _label_cells_of(recipe: DomainRecipe) -> Callable[[int, MembraneState], Row]:
    """Return what makes the label columns of one frame; what does not depend on the frame is found once."""
    names = [column.name for column in (*LABELS, *_optional(recipe)) if column.is_label]
    poses = recipe.commanded_poses()
    travels = trajectories(recipe.path.poses)
    split = draw_parts(recipe.frames, recipe.seed)
    last_travel = max(number for number, _ in travels) + 1
    bias_n = recipe.drawn_errors().force_bias_n
    noise_n = recipe.acquisition.force_noise_n

    def cells(frame: int, state: MembraneState) -> Row:
        read_n = np.asarray(state.force_n, float) + bias_n
        if noise_n:
            rng = random_stream(recipe.seed, recipe.picture_name, "force noise", frame)
            read_n = read_n + noise_n * rng.standard_normal(3)
        # Adding zero turns −0.0, which some readers show, into 0.0.
        force_n = tuple(float(value) + 0.0 for value in read_n)
        turn, place = divmod(frame, len(poses))
        travel, step = travels[place]
        travel += turn * last_travel
        body = recipe.indenters[turn].label
        contact = Contact(frame, poses[place], travel, step, PARTS[split[frame]], state, force_n, body)
        return {name: LABEL_MAKERS[name](contact) for name in names}

    return cells


def trajectories(poses: Sequence[Pose]) -> list[tuple[int, int]]:
    """Return (trajectory, step) of each frame: the path's, or the travel at one point, depth and direction."""
    travels = pd.Series(
        [
            (pose.point_id, pose.depth_mm, pose.angle_deg if pose.radius_mm else -1.0)
            if pose.trajectory is None
            else ("trajectory", pose.trajectory)
            for pose in poses
        ]
    )
    groups = travels.groupby(travels, sort=False)
    return list(zip(groups.ngroup(), groups.cumcount(), strict=True))
