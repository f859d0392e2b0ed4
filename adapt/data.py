"""The frames that training sees: on the device, in which order, and changed at random.

Every random draw depends on a key alone (the seed, what it is for, and the epoch or step), so that a resumed training
sees what it would have seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from gelgap.adapt.inputs import FITTED, INPUTS, Fit, Found, InputMap, mapped
from gelgap.adapt.profile import Profile
from gelgap.data import LabelledFrames, Labels
from gelgap.data.frames.first_touch import STEP, trajectory_of
from gelgap.data.frames.paired_frames import PairedFrames

# Labels that turn with a picture, and those that no part of a picture shows.
_TURNING = ("fx_n", "fy_n"), ("mx_nmm", "my_nmm")
_PLACE = "x_mm", "y_mm"
SAME_ASPECT = 0.02
"""Aspects that differ by no more than this share are taken for the same."""


def has_other_aspect(size_px: tuple[int, int], of_px: tuple[int, int]) -> bool:
    """Return whether pictures of one width and height would be squeezed to another."""
    return abs(size_px[0] * of_px[1] / (size_px[1] * of_px[0]) - 1) > SAME_ASPECT


class Draw(IntEnum):
    """What random numbers are drawn for: part of every draw's key, so that no draw depends on another."""

    STAGE_1 = 1
    STAGE_2 = 2
    STAGE_2_TARGET = 3
    STATISTICS = 4
    COLOURS = 7
    MARKERS = 8
    LABELLED = 9
    FINE_TUNING = 10
    METHOD = 11
    SHIFTS = 12
    TURNS = 13
    TORCH = 14


def generator(*key: int) -> np.random.Generator:
    """Return a random generator that depends on the key alone."""
    return np.random.default_rng(np.random.SeedSequence(key))


def steps_per_epoch(n: int, batch_size: int) -> int:
    """Return the number of full batches in n frames; fewer frames than a batch make one."""
    return n // min(batch_size, n)


def epoch_order(n: int, batch_size: int, *key: int) -> np.ndarray:
    """Return a permutation of n frames, drawn by the key, as full batches (batches, batch_size).

    The incomplete last batch is left out: its batch statistics would be noisier than the others'.
    """
    size, steps = min(batch_size, n), steps_per_epoch(n, batch_size)
    return generator(*key).permutation(n)[: steps * size].reshape(steps, size)


def hidden_batches(n: int, share: float, *key: int) -> np.ndarray:
    """Return which of n batches are shown without markers, (n,) bool, drawn by the key.

    Whole batches, so that frames without markers are normalised by their like, as a target without markers will be.
    """
    return generator(Draw.MARKERS, *key).random(n) < share


def windows_of(frames: LabelledFrames, length: int) -> np.ndarray:
    """Return for each frame the rows (n, length) of its trajectory up to it, by step, the frame itself last.

    Before a trajectory its first frame is repeated: no window crosses from one into another.
    """
    trajectory = trajectory_of(frames)
    n = np.arange(len(frames))
    order = np.lexsort([frames.columns[STEP], trajectory])
    begins = np.append(True, np.diff(trajectory[order]) != 0)
    first = np.maximum.accumulate(np.where(begins, n, 0))
    places = np.maximum(n[:, None] - np.arange(length)[::-1], first[:, None])
    windows = np.empty((len(frames), length), np.int64)
    windows[order] = order[places]
    return windows


def check_turning(names: Sequence[str]) -> None:
    """Check that labels of these names turn with a dent (`turn_dents`), or stay."""
    lone = [name for x, y in _TURNING if (x in names) != (y in names) for name in (x, y) if name in names]
    if unread := [*lone, *(name for name in _PLACE if name in names)]:
        raise ValueError(
            f"input touch cannot show {', '.join(unread)}: training turns dents, shown from where they were first "
            "touched; forces and torques along x and y are predicted together, places not at all"
        )


@dataclass(frozen=True, eq=False)
class NetworkInputs:
    """The pictures of a domain as a network is shown them, on the device, a batch at a time.

    `windows` (n, length) are the rows of each frame's sequence; None shows the frame alone. Where data sets are joined,
    `of_frames` are the matrix (n, c, C) and offset (n, c) of each frame's own map.
    """

    pictures: PairedFrames | Found
    map: InputMap | None = None
    windows: Tensor | None = None
    of_frames: tuple[Tensor, ...] = ()

    def inputs(self, rows: np.ndarray | Tensor) -> Tensor:
        """Return inputs (B, C, h, w) float32 of these frames; the frames of a sequence along C, the oldest first."""
        if self.windows is None:
            return self._of_frames(rows)
        windows = self.windows[torch.as_tensor(rows, device=self.windows.device)]
        sequences = self._of_frames(windows.flatten()).unflatten(0, windows.shape).flatten(1, 2)
        return sequences.contiguous(memory_format=torch.channels_last)

    def _of_frames(self, rows: np.ndarray | Tensor) -> Tensor:
        paired = self.pictures.inputs(rows)
        if self.of_frames:
            return mapped(paired, *(values[rows] for values in self.of_frames))
        return paired if self.map is None else self.map(paired)

    def __len__(self) -> int:
        return len(self.pictures)


def network_inputs(
    frames: LabelledFrames,
    profile: Profile,
    device: torch.device,
    input_map: InputMap | None = None,
    markers: bool = True,
) -> NetworkInputs:
    """Return the frames' pictures on the device as the profile shows them to the network.

    Where its input has a map for each domain, it is the given one, or else that of these frames. Of joined data sets
    each has its own, by all of its pictures: 0.040 N for 0.051 N in eight lights. Without `markers` they are inpainted.
    """
    shown = INPUTS[profile.input]
    windows = None
    if profile.levelling:
        frames = frames.levelled
    if profile.sequence_length > 1:
        windows = torch.from_numpy(windows_of(frames, profile.sequence_length)).to(device)
    if shown.find is not None:
        fields = Found(shown.find, frames, profile.image_size_px, profile.marker_span_mm, device)
        return NetworkInputs(fields, windows=windows)
    pictures = frames.torch(profile.image_size_px, profile.pairing, device, markers=markers)
    if shown.fit is None:
        return NetworkInputs(pictures, windows=windows)
    if input_map is not None:
        return NetworkInputs(pictures, input_map, windows)
    if profile.input not in FITTED or not frames.owners:
        return NetworkInputs(pictures, _fitted(shown.fit, frames, profile, pictures), windows)
    maps = {}
    for owner in set(frames.owners):
        of_owner = owner.torch(profile.image_size_px, profile.pairing, device)
        maps[owner] = _fitted(shown.fit, owner, profile, of_owner)
    each = [maps[frames.owners[number]] for number in frames.reference_id]
    of_frames = tuple(torch.tensor(values, device=device) for values in zip(*each, strict=True))
    return NetworkInputs(pictures, None, windows, of_frames)


def _fitted(fit: Fit, frames: LabelledFrames, profile: Profile, pictures: PairedFrames) -> InputMap:
    try:
        return fit(pictures)
    except ValueError as error:
        raise ValueError(f"input {profile.input}: {frames.name}: {error}") from None


def check_classes(source: LabelledFrames, method: str) -> None:
    """Check that all frames of a source have a contact class, and not all the same, as a method needs it.

    Raises
    ------
    ValueError
        If it is not so; the message names the method.
    """
    if not source.has_classes:
        raise ValueError(
            f"method {method} needs contact classes, and source {source.name} has frames without one: choose "
            "another method, classes from force (--classes from-force 12), or a source whose frames all have a "
            "class, as `gelgap generate` writes them on the paper's path"
        )
    if len(np.unique(source.contact_class)) < 2:
        raise ValueError(
            f"method {method} needs source frames of at least 2 contact classes, and the {len(source)} of "
            f"{source.name} are of one: take more frames, or choose another method"
        )


def normalised_labels(frames: LabelledFrames) -> np.ndarray:
    """Return the labels (n, k) float32, min-max normalised with their ranges to [0, 1]."""
    low, high = frames.labels.low, frames.labels.high
    return ((frames.label_values.astype(np.float32) - low) / (high - low)).astype(np.float32)


class Batch(NamedTuple):
    """Network inputs (B, C, h, w) of one domain, and their labels where known.

    force is (B, k), labels normalised to [0, 1]; contact_class (B,).
    """

    inputs: Tensor
    force: Tensor | None
    contact_class: Tensor | None


class TrainingDomain:
    """One domain on the device: pictures, also with their markers inpainted where training shows them so, and labels.

    Labels are there only if they are asked for.
    """

    def __init__(
        self, frames: LabelledFrames, profile: Profile, device: torch.device, *, labelled: bool
    ) -> None:
        if len(frames) < 2:
            raise ValueError(f"{frames.name}: {len(frames)} frame(s); training needs at least 2 of a domain")
        self.pictures = network_inputs(frames, profile, device)
        self.without_markers: NetworkInputs | None = None
        if profile.marker_hiding:
            self.without_markers = network_inputs(frames, profile, device, self.pictures.map, markers=False)
        self.device = device
        self.labels = frames.labels
        self.force: Tensor | None = None
        self.contact_class: Tensor | None = None
        if labelled:
            self.force = torch.from_numpy(normalised_labels(frames)).to(device)
            self.contact_class = torch.from_numpy(frames.contact_class.astype(np.int64)).to(device)

    def batch(self, indices: np.ndarray, hidden: bool) -> Batch:
        """Return a batch of these frames (B,), their markers `hidden` or not."""
        rows = torch.from_numpy(indices).to(self.device)
        pictures = self.pictures
        if hidden and self.without_markers is not None:
            pictures = self.without_markers
        inputs = pictures.inputs(rows)
        if self.force is None or self.contact_class is None:
            return Batch(inputs, None, None)
        return Batch(inputs, self.force[rows], self.contact_class[rows])

    def __len__(self) -> int:
        return len(self.pictures)


def mix_colours(pictures: Tensor, share: float, rng: np.random.Generator) -> Tensor:
    """Turn the colours of a share of network inputs (B, channels, h, w), each by its own rotation or reflection.

    Under lamps of other colours in other places each channel sees the membrane's slopes along other directions; mixed
    channels show a network many such lights, so that it must read forces from what they share.
    """
    if share == 0:
        return pictures
    chosen = torch.from_numpy(rng.random(len(pictures)) < share).to(pictures.device)
    turns, _ = np.linalg.qr(rng.standard_normal((len(pictures), 3, 3)))
    turns = torch.from_numpy(turns.astype(np.float32)).to(pictures.device)
    matrices = torch.where(chosen[:, None, None], turns, torch.eye(3, device=pictures.device))
    colours = pictures.unflatten(1, (-1, 3))
    mixed = torch.einsum("nij,ngjhw->ngihw", matrices, colours).flatten(1, 2)
    return mixed.contiguous(memory_format=torch.channels_last)


def shift_pictures(pictures: Tensor, most_px: int, rng: np.random.Generator) -> Tensor:
    """Shift network inputs (B, channels, h, w), each along x and y by its own whole number of pixels up to `most_px`.

    Contact and reference are shifted together, and their edges are continued. A network that has seen few contact
    points takes the light at each of them for the force; the same contact elsewhere shows it what the force does.
    """
    if most_px == 0:
        return pictures
    height, width = pictures.shape[2:]
    padded = functional.pad(pictures, (most_px,) * 4, mode="replicate")
    offsets = rng.integers(0, 2 * most_px + 1, (len(pictures), 2)).tolist()
    shifted = [padded[k, :, y : y + height, x : x + width] for k, (x, y) in enumerate(offsets)]
    return torch.stack(shifted).contiguous(memory_format=torch.channels_last)


def turn_dents(batch: Batch, labels: Labels, rng: np.random.Generator) -> Batch:
    """Turn inputs (B, C, h, w) about their centre, each by an angle of its own, forces and torques with them.

    A dent that is turned is a dent under lamps elsewhere: a network must read forces from what all lights share. That
    takes R² of shear in another light from 0.6 to 0.96 (docs/results/light.md). Beyond the edge nothing has changed.
    """
    angle = torch.from_numpy(rng.uniform(0, 2 * np.pi, len(batch.inputs))).to(batch.inputs)
    cos = angle.cos()
    sin = angle.sin()
    zero = torch.zeros_like(angle)
    height, width = batch.inputs.shape[2:]
    # Of the place that is shown at a pixel; either axis runs from −1 to 1.
    rows = (cos, sin * height / width, zero), (-sin * width / height, cos, zero)
    before = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
    grid = functional.affine_grid(before, list(batch.inputs.shape), align_corners=False)
    inputs = functional.grid_sample(batch.inputs, grid, align_corners=False)
    inputs = inputs.contiguous(memory_format=torch.channels_last)
    if batch.force is None:
        return batch._replace(inputs=inputs)
    low, high = (batch.force.new_tensor(bound) for bound in (labels.low, labels.high))
    values = low + batch.force * (high - low)
    turned = values.clone()
    for pair in _TURNING:
        if pair[0] in labels.names:
            x, y = map(labels.names.index, pair)
            turned[:, x] = cos * values[:, x] - sin * values[:, y]
            turned[:, y] = sin * values[:, x] + cos * values[:, y]
    return batch._replace(inputs=inputs, force=(turned - low) / (high - low))
