"""
One network for any light
=========================

A network reads force, shear too, in a light that it has never seen, by four pictures of a ball pressed at known places:
they turn its colours into slopes. It is trained once, in drawn lights; another sensor of this gel needs no training.
Lamps must have different colours: in white light alone four presses bring nothing.

It takes four core minutes; ``python examples/any_light.py 3 4 20``, of 3 lights, 4 contacts in each and 20 steps, shows
within half a minute that it runs.
"""

import sys
from collections.abc import Callable
from itertools import combinations_with_replacement

import cv2
import numpy as np
import torch
from torch import nn

from gelgap.adapt.network import ResNet
from gelgap.domains import make_recipes
from gelgap.domains.drawn_lights import KINDS, drawn_illumination
from gelgap.render import Illumination, MembraneRenderer
from gelgap.sim import LibraryPlan, Pose, PoseLibrary, PoseRanges, Sphere
from gelgap.sim.library import solve_all

RENDERED_PX, SHRUNK_PX, CUT_PX, SHIFT_PX = (160, 120), (64, 48), 32, 4
# x and y of pixels (48, 64, 2) from the middle, in half widths.
PLACES = np.dstack(np.meshgrid(*(np.arange(n) - (n - 1) / 2 for n in SHRUNK_PX))) / (SHRUNK_PX[0] / 2)
RANGES, FARTHEST_MM = PoseRanges(shallowest_mm=0.18, deepest_mm=0.98, travel_mm=0.57), (3.75, 2.6)
# Depth, x and y of the ball's presses in mm.
PRESSES = (0.6, -3, -1.6), (0.95, 1, -1.6), (0.95, -1, 1.6), (0.6, 3, 1.6)
# The network's input: change of colour (3), reference (3), the table's doubt, slopes along x and y, place x and y.
CHANNELS, SLOPES, ALONG_X, ALONG_Y = 11, [7, 8], [7, 9], [8, 10]
MEAN_N, SPREAD_N = np.array([0, 0, -0.75], np.float32), np.array([0.17, 0.17, 0.6], np.float32)
# Shares of the steps: true slopes are shown first, then more and more of the table's.
TRUE_UNTIL, TABLE_FROM = 0.13, 0.35
RATE = 3e-3
# Of n contacts: inputs (n, 11, h, w), true slopes (n, 2, h, w) and forces (n, 3), N.
Contacts = tuple[np.ndarray, np.ndarray, np.ndarray]


def main(lights: int = 300, contacts: int = 20, steps: int = 4500, seed: int = 0) -> None:
    torch.manual_seed(seed)
    (recipe,) = make_recipes(["wmb0i0"], "smoke")
    plan = LibraryPlan(recipe.elastomer, Sphere(diameter_mm=3.0), RANGES, "draft")
    library = plan.build(solve_all(plan.solved.solves))
    presets = [Illumination.preset(name) for name in KINDS]
    renderer = MembraneRenderer(recipe.sensor, presets[0], RENDERED_PX, "draft")
    first, unseen, training = 1000 * seed, 1000 * seed + lights, []
    for number in range(first, unseen):
        light = renderer.relit(drawn_illumination(10_000 + number, presets))
        training.append(contacts_in(light, library, contacts, number))
    network = train(training, steps, seed)
    for name, preset in zip(KINDS, presets, strict=True):
        inputs, _, force_n = contacts_in(renderer.relit(preset), library, 10 * contacts, unseen)
        error_n = predict(network, inputs) - force_n
        mean_n, r2 = np.abs(error_n).mean(0), 1 - (error_n**2).mean(0) / force_n.var(0)
        print(f"{name}, never seen: mean error {mean_n.round(3)} N, R² {r2.round(2)} of Fx, Fy, Fz")


def contacts_in(light: MembraneRenderer, library: PoseLibrary, n: int, seed: int) -> Contacts:
    """Return drawn contacts seen in one light, with the slopes that its own presses of the ball give to its colours."""
    rng = np.random.default_rng([seed, 79])
    reference = shrunk(light.reference(markers=False, rng=rng) / 255)
    presses = [seen(light, library, Pose(depth, 0, 0, x, y), reference, rng) for depth, x, y in PRESSES]
    table = slopes_by_colour(*(np.stack([press[part] for press in presses]) for part in (0, 1)))
    inputs, true_slopes, forces_n = [], [], []
    for _ in range(n):
        depth_mm = rng.uniform(RANGES.shallowest_mm, RANGES.deepest_mm)
        travel_mm, angle = rng.uniform(0, RANGES.travel_mm), rng.uniform(0, 2 * np.pi)
        x_mm, y_mm = rng.uniform(-1, 1, 2) * FARTHEST_MM
        pose = Pose(depth_mm, travel_mm * np.cos(angle), travel_mm * np.sin(angle), x_mm, y_mm)
        change, slopes, force_n = seen(light, library, pose, reference, rng)
        layers = np.dstack([change, reference - 0.5, table(change), PLACES])
        inputs.append(cut_out(layers, change))
        true_slopes.append(cut_out(slopes, change))
        forces_n.append(force_n)
    return np.array(inputs, np.float16), np.array(true_slopes, np.float16), np.array(forces_n, np.float32)


def seen(
    light: MembraneRenderer, library: PoseLibrary, pose: Pose, reference: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a press's change of colour (h, w, 3), its true slopes (h, w, 2) and its force (3,), N."""
    axes_mm = light.lattice.x_mm, light.lattice.y_mm
    state = library.state(library.plan.elastomer, pose, axes_mm=axes_mm)
    if not state.converged:
        raise RuntimeError(f"{pose} did not converge")
    picture = shrunk(light.picture(*axes_mm, state.displacement_mm, markers=False, rng=rng) / 255)
    normals = light.normal_map(*axes_mm, state.displacement_mm)
    return 4 * (picture - reference), shrunk(normals[..., :2] / normals[..., 2:]), state.force_n


def slopes_by_colour(changes: np.ndarray, slopes: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Return a ridge regression of slopes (n, h, w, 2) on changes of colour (n, h, w, 3) up to cubes, times place.

    Of a change (h, w, 3) it gives (h, w, 3): how unlike those that it was fitted to, and the slopes along x and y.
    """
    used = np.linalg.norm(slopes, axis=-1) > 0.01
    used.flat[::25] = True  # and some of the flat gel
    columns = columns_of(changes)[used]
    moments = columns.T @ columns / len(columns)
    inverse = np.linalg.inv(moments + np.diag(2e-4 * np.diag(moments) + 1e-12))
    weights, root = inverse @ (columns.T @ slopes[used] / len(columns)), np.linalg.cholesky(inverse)

    def by_colour(change: np.ndarray) -> np.ndarray:
        columns = columns_of(change)
        doubt = np.sqrt(np.linalg.norm(columns @ root, axis=-1)) / 3
        return np.dstack([doubt, np.clip(columns @ weights, -2, 2)])

    return by_colour


def columns_of(change: np.ndarray) -> np.ndarray:
    """Return (..., h, w, 57): the 19 monomials of three colours, degrees 1 to 3, each times 1, x and y."""
    factors = [colours for degree in (1, 2, 3) for colours in combinations_with_replacement(range(3), degree)]
    monomials = np.stack([change[..., list(colours)].prod(-1) for colours in factors], -1)
    by_place = monomials[..., None] * np.dstack([np.ones(PLACES.shape[:2]), PLACES])[:, :, None]
    return by_place.reshape(*change.shape[:-1], -1)


def shrunk(picture: np.ndarray) -> np.ndarray:
    return cv2.resize(picture.astype(np.float32), SHRUNK_PX, interpolation=cv2.INTER_AREA)


def cut_out(layers: np.ndarray, change: np.ndarray) -> np.ndarray:
    """Return (channels, h, w) around the middle of what has changed, with a margin to shift it."""
    strength = cv2.GaussianBlur(np.abs(change).sum(-1), (5, 5), 0)
    weight = np.where(strength > 0.3 * strength.max(), strength**2, 0)
    y, x = (round((weight * axis).sum() / weight.sum()) for axis in np.indices(weight.shape))
    half = CUT_PX // 2 + SHIFT_PX
    padded = np.pad(layers, ((half, half), (half, half), (0, 0)), mode="edge")
    return np.moveaxis(padded[y : y + 2 * half, x : x + 2 * half], -1, 0)


def turned(inputs: np.ndarray, forces: np.ndarray, turn: int) -> tuple[np.ndarray, np.ndarray]:
    """Return inputs (n, 11, h, w) and forces (n, 3) as in one of the eight mirrors and quarter turns, 0 to 7."""
    forces = forces.copy()
    for axis, components in enumerate((ALONG_X, ALONG_Y)):
        if turn & 2**axis:
            inputs = np.flip(inputs, 3 - axis).copy()
            inputs[:, components] *= -1
            forces[:, axis] *= -1
    if turn & 4:
        inputs, forces = inputs.swapaxes(-1, -2).copy(), forces[:, [1, 0, 2]]
        inputs[:, ALONG_X + ALONG_Y] = inputs[:, ALONG_Y + ALONG_X]
    return inputs, forces


def train(sensors: list[Contacts], steps: int, seed: int) -> nn.Module:
    """Return a network trained on each sensor's contacts; its outputs are forces over `SPREAD_N`, less `MEAN_N`."""
    inputs, slopes, forces_n = (np.concatenate(part) for part in zip(*sensors, strict=True))
    forces, rng = (forces_n - MEAN_N) / SPREAD_N, np.random.default_rng(seed)
    backbone = ResNet("resnet18", CHANNELS, 0.25)
    network = nn.Sequential(backbone, nn.Linear(backbone.out_features, 256), nn.ReLU(), nn.Linear(256, 3))
    network.to(memory_format=torch.channels_last)
    optimiser = torch.optim.AdamW(network.parameters(), RATE, weight_decay=0.02, fused=True)
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = RATE * min(1, (step + 1) / 100, 2 * (1 - step / steps))
        share = np.clip((step / steps - TRUE_UNTIL) / (TABLE_FROM - TRUE_UNTIL), 0, 1).astype(np.float32)
        groups = []
        for rows in rng.choice(len(inputs), (8, 8)):  # eight frames are shifted, coloured and turned alike
            y, x = rng.integers(0, 2 * SHIFT_PX + 1, 2)
            window = np.s_[rows, :, y : y + CUT_PX, x : x + CUT_PX]
            shown = inputs[window].astype(np.float32)
            shown[:, SLOPES] = share * shown[:, SLOPES] + (1 - share) * slopes[window]
            colours = rng.permutation(3)
            shown[:, :6] = shown[:, [*colours, *(3 + colours)]]
            groups.append(turned(shown, forces[rows], int(rng.integers(8))))
        pictures, wanted = (torch.from_numpy(np.concatenate(part)) for part in zip(*groups, strict=True))
        loss = (network(pictures.to(memory_format=torch.channels_last)) - wanted).square().mean()
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimiser.step()
        if (step + 1) % 500 == 0:
            print(f"step {step + 1}, loss {loss.item():.2f}, {share:.0%} of the table", flush=True)
    return network.eval()


@torch.inference_mode()
def predict(network: nn.Module, inputs: np.ndarray) -> np.ndarray:
    """Return forces (n, 3), N."""
    middle = inputs[:, :, SHIFT_PX:-SHIFT_PX, SHIFT_PX:-SHIFT_PX].astype(np.float32)
    return MEAN_N + SPREAD_N * network(torch.from_numpy(middle)).numpy()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
