"""
One network for any light
=========================

A network reads force, shear too, in a light that it has never seen, by four pictures of a ball pressed at known places:
they turn its colours into slopes. It is trained once, in drawn lights; another sensor of this gel needs no training.
"""

import sys
from dataclasses import dataclass
from itertools import combinations_with_replacement

import cv2
import numpy as np
import torch
from torch import nn

from gelgap.adapt.network import ResNet
from gelgap.domains import make_recipes
from gelgap.domains.drawn_lights import KINDS, drawn_illumination
from gelgap.render import Illumination, MembraneRenderer
from gelgap.sim import LibraryPlan, MembraneState, Pose, PoseLibrary, PoseRanges, Sphere
from gelgap.sim.library import solve_all

RENDERED_PX, SHOWN_PX, CUT_PX, SHIFT_PX = (160, 120), (64, 48), 32, 4
RANGES = PoseRanges(shallowest_mm=0.18, deepest_mm=0.98, travel_mm=0.57)
FARTHEST_MM = 3.75, 2.6
PLACES_MM = ((-3, -1.6), (1, -1.6), (-1, 1.6), (3, 1.6), (-1, -1.6), (3, -1.6), (-3, 1.6), (1, 1.6))
PRESSES = tuple(Pose((0.6, 0.95)[(k + k // 2) % 2], 0.0, 0.0, x, y) for k, (x, y) in enumerate(PLACES_MM))
# Of an input: change of colour, reference, how far the table is stretched, and two vectors: slopes, place.
CHANNELS, SLOPES, PLACE = 11, slice(7, 9), slice(9, 11)
MEAN_N, SPREAD_N = np.array([0, 0, -0.75], np.float32), np.array([0.17, 0.17, 0.6], np.float32)
# Shares of the steps: true slopes are shown first, then more and more of the table's. Otherwise shear is not learnt.
TRUE_UNTIL, TABLE_FROM = 0.13, 0.35
BATCH, ALIKE = 64, 8
RATE = 3e-3


def main(lights: int = 300, contacts: int = 20, steps: int = 4500, presses: int = 4, seed: int = 0) -> None:
    torch.manual_seed(seed)
    (recipe,) = make_recipes(["wmb0i0"], "smoke")
    plan = LibraryPlan(recipe.elastomer, Sphere(diameter_mm=3.0), RANGES, "draft")
    library = plan.build(solve_all(plan.solved.solves))
    kinds = [Illumination.preset(name) for name in KINDS]
    renderer = MembraneRenderer(recipe.sensor, kinds[0], RENDERED_PX, "draft")
    drawn = [
        LitSensor(library, renderer.relit(drawn_illumination(10_000 + number, kinds)), presses, number)
        for number in range(lights)
    ]
    network = train([sensor.contacts(contacts) for sensor in drawn], steps, seed)
    for name, kind in zip(KINDS, kinds, strict=True):
        sensor = LitSensor(library, renderer.relit(kind), presses, lights)
        inputs, _, force_n = sensor.contacts(10 * contacts)
        error_n = predict(network, inputs) - force_n
        shear, normal = np.abs(error_n[:, :2]).mean(), np.abs(error_n[:, 2]).mean()
        r2 = ", ".join(f"{own:.2f}" for own in 1 - (error_n**2).mean(0) / force_n.var(0))
        print(f"{name}, never seen: shear {shear:.3f} N, Fz {normal:.3f} N, R² {r2}")


@dataclass(frozen=True)
class SlopeTable:
    """Slopes by colour: a ridge regression on changes of colour up to cubes, times place, fitted to presses."""

    weights: np.ndarray  # (57, 2)
    spread: np.ndarray  # (57, 57), by which columns are as long as they are unlike those of the presses

    @classmethod
    def of(cls, changes: np.ndarray, slopes: np.ndarray) -> "SlopeTable":
        """Fit changes of colour (n, h, w, 3) to known slopes (n, h, w, 2)."""
        dented = np.hypot(slopes[..., 0], slopes[..., 1]) > 0.01
        dented.reshape(-1)[::25] = True  # and some of the flat gel
        columns = np.stack([columns_of(change) for change in changes])[dented]
        scale = np.sqrt((columns**2).mean(0)) + 1e-9
        columns = columns / scale
        inverse = np.linalg.inv(columns.T @ columns / len(columns) + 2e-4 * np.eye(columns.shape[1]))
        weights = inverse @ (columns.T @ slopes[dented] / len(columns))
        return cls(weights / scale[:, None], np.linalg.cholesky(inverse) / scale[:, None])

    def __call__(self, change: np.ndarray) -> np.ndarray:
        """Return (h, w, 3): how far the table is stretched, and the slopes along x and y."""
        columns = columns_of(change)
        stretched = np.sqrt(np.linalg.norm(columns @ self.spread, axis=-1)) / 3
        return np.dstack([stretched, np.clip(columns @ self.weights, -2, 2)])


def columns_of(change: np.ndarray) -> np.ndarray:
    """Return (h, w, 57): monomials of three colours, degrees 1 to 3, each times 1, x and y."""
    monomials = [own for degree in (1, 2, 3) for own in combinations_with_replacement(range(3), degree)]
    by_colour = np.moveaxis(change, -1, 0)
    colours = np.stack([by_colour[list(own)].prod(0) for own in monomials], -1)
    place = np.concatenate([np.ones((*change.shape[:2], 1)), places(*change.shape[:2])], -1)
    return (colours[..., None] * place[..., None, :]).reshape(*change.shape[:2], -1)


def places(height: int, width: int) -> np.ndarray:
    """Return (h, w, 2): x and y of pixels from the middle, in half widths."""
    y, x = np.mgrid[:height, :width].astype(float)
    return np.dstack([x - (width - 1) / 2, y - (height - 1) / 2]) / (width / 2)


class LitSensor:
    """The gel in one light, its reference, and the table of its presses; without presses slopes are 0."""

    def __init__(self, library: PoseLibrary, renderer: MembraneRenderer, presses: int, seed: int) -> None:
        self.library, self.renderer, self.rng = library, renderer, np.random.default_rng([seed, 79])
        self.reference, self.table = small(renderer.reference(markers=False, rng=self.rng)), None
        if presses:
            seen = [self.seen(self.state(press)) for press in PRESSES[:presses]]
            self.table = SlopeTable.of(*(np.stack(parts) for parts in zip(*seen, strict=True)))

    def state(self, pose: Pose) -> MembraneState:
        lattice = self.renderer.lattice
        return self.library.state(self.library.plan.elastomer, pose, axes_mm=(lattice.x_mm, lattice.y_mm))

    def seen(self, state: MembraneState) -> tuple[np.ndarray, np.ndarray]:
        """Return the change of colour (h, w, 3), and the true slopes (h, w, 2)."""
        membrane = state.x_mm, state.y_mm, state.displacement_mm
        change = small(self.renderer.picture(*membrane, False, self.rng)) - self.reference
        normals = self.renderer.normal_map(*membrane)
        return 4 * change, small(normals[..., :2] / normals[..., 2:])

    def contacts(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return inputs (n, 11, h, w) and true slopes (n, 2, h, w) cut out around drawn dents, and forces (n, 3), N."""
        inputs: list[np.ndarray] = []
        slopes, forces_n = [], []
        while len(inputs) < n:
            depth_mm = self.rng.uniform(RANGES.shallowest_mm, RANGES.deepest_mm)
            travel_mm, angle = self.rng.uniform(0, RANGES.travel_mm), self.rng.uniform(0, 2 * np.pi)
            place_mm = self.rng.uniform(-1, 1, 2) * FARTHEST_MM
            shear_mm = travel_mm * np.array([np.cos(angle), np.sin(angle)])
            state = self.state(Pose(depth_mm, *shear_mm.tolist(), *place_mm.tolist()))
            if state.converged:
                change, true = self.seen(state)
                cut = cut_out(np.dstack([shown(change, self.reference, self.table), true]), change)
                inputs.append(cut[:CHANNELS])
                slopes.append(cut[CHANNELS:])
                forces_n.append(state.force_n)
        return np.array(inputs, np.float16), np.array(slopes, np.float16), np.array(forces_n, np.float32)


def shown(change: np.ndarray, reference: np.ndarray, table: SlopeTable | None) -> np.ndarray:
    """Return what the network is shown of a change of colour (h, w, 3), before it is cut out: (h, w, 11)."""
    by_table = np.zeros_like(change) if table is None else table(change)
    return np.dstack([change, reference - 0.5, by_table, places(*change.shape[:2])])


def small(picture: np.ndarray) -> np.ndarray:
    """Return a picture, in [0, 1] if it is uint8, or a map at the size that is shown, by area means."""
    scale = 255 if picture.dtype == np.uint8 else 1
    return cv2.resize(picture.astype(np.float32), SHOWN_PX, interpolation=cv2.INTER_AREA) / scale


def cut_out(layers: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return (channels, h, w) around the middle of what has changed, with a margin to shift it."""
    strength = cv2.GaussianBlur(np.abs(change).sum(-1), (5, 5), 0)
    weight = np.where(strength > 0.3 * strength.max(), strength**2, 0)
    y, x = (round((weight * axis).sum() / weight.sum()) for axis in np.indices(weight.shape))
    half = CUT_PX // 2 + SHIFT_PX
    padded = np.pad(layers, ((half, half), (half, half), (0, 0)), mode="edge")
    return np.moveaxis(padded[y : y + 2 * half, x : x + 2 * half], -1, 0)


def turned(pictures: np.ndarray, forces_n: np.ndarray, turn: int) -> tuple[np.ndarray, np.ndarray]:
    """Return inputs (n, 11, h, w) and forces (n, 3) as in one of the eight mirrors and quarter turns, 0 to 7."""
    pictures, forces_n = pictures.copy(), forces_n.copy()
    for bit, axis in ((1, -1), (2, -2)):  # along x, along y
        if turn & bit:
            pictures = np.flip(pictures, axis).copy()
            for vector in (SLOPES, PLACE):
                pictures[:, vector.start - 1 - axis] *= -1
            forces_n[:, -1 - axis] *= -1
    if turn & 4:
        pictures, forces_n = np.swapaxes(pictures, -1, -2).copy(), forces_n[:, [1, 0, 2]]
        for vector in (SLOPES, PLACE):
            pictures[:, vector] = pictures[:, vector][:, ::-1].copy()
    return pictures, forces_n


def train(parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]], steps: int, seed: int) -> nn.Module:
    """Return a network of inputs (n, 11, h, w) whose outputs are forces over `SPREAD_N`, less `MEAN_N`."""
    inputs, slopes, forces_n = (np.concatenate(part) for part in zip(*parts, strict=True))
    backbone = ResNet("resnet18", CHANNELS, 0.25)
    network = nn.Sequential(backbone, nn.Linear(backbone.out_features, 256), nn.ReLU(), nn.Linear(256, 3))
    network.to(memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(network.parameters(), RATE, weight_decay=0.02, fused=True)
    rng, losses = np.random.default_rng(seed), []
    for step in range(steps):
        for group in optimiser.param_groups:
            group["lr"] = RATE * min(1, (step + 1) / 100, 2 * (1 - step / steps))
        share = np.clip((step / steps - TRUE_UNTIL) / (TABLE_FROM - TRUE_UNTIL), 0, 1).astype(np.float32)
        seen, wanted = [], []
        for rows in rng.choice(len(inputs), (BATCH // ALIKE, ALIKE)):
            y, x = rng.integers(0, 2 * SHIFT_PX + 1, 2)
            own = inputs[rows, :, y : y + CUT_PX, x : x + CUT_PX].astype(np.float32)
            own[:, SLOPES] *= share
            own[:, SLOPES] += (1 - share) * slopes[rows, :, y : y + CUT_PX, x : x + CUT_PX]
            order = rng.permutation(3)
            own[:, :6] = own[:, [*order, *(3 + order)]]
            own, force_n = turned(own, forces_n[rows], int(rng.integers(8)))
            seen.append(own)
            wanted.append((force_n - MEAN_N) / SPREAD_N)
        predicted = network.train()(on_torch(np.concatenate(seen)))
        loss = (predicted - torch.from_numpy(np.concatenate(wanted))).square().mean()
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
        losses.append(loss.item())
        if (step + 1) % 500 == 0:
            print(f"step {step + 1}, loss {np.mean(losses[-200:]):.3f}, {share:.0%} of the table", flush=True)
    return network.eval()


@torch.inference_mode()
def predict(network: nn.Module, inputs: np.ndarray) -> np.ndarray:
    """Return forces (n, 3), N."""
    inner = inputs[:, :, SHIFT_PX:-SHIFT_PX, SHIFT_PX:-SHIFT_PX].astype(np.float32)
    return MEAN_N + SPREAD_N * network(on_torch(inner)).numpy()


def on_torch(pictures: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(pictures).contiguous(memory_format=torch.channels_last)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
