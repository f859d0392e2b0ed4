"""Batches of one domain on the training device, and the order in which an epoch takes its frames."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
import torch
from torch import Tensor

from gelgap.adapt.profile import Profile
from gelgap.domains import ChannelStatistics, LabelledFrames, PairedFrames


class Draw(IntEnum):
    """What random numbers are drawn for: part of every draw's key, so that no draw depends on another."""

    STAGE_1 = 1
    STAGE_2 = 2
    STAGE_2_TARGET = 3
    STATISTICS = 4
    SOURCE_PASS = 5
    TARGET_PASS = 6
    COLOURS = 7
    MARKERS = 8
    LABELLED = 9
    FINE_TUNING = 10
    METHOD = 11
    SHIFTS = 12


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


def network_inputs(
    frames: LabelledFrames,
    profile: Profile,
    device: torch.device,
    statistics: ChannelStatistics | None = None,
    markers: bool = True,
) -> PairedFrames:
    """Return the frames' pictures on the device, in the size and pairing of the profile.

    Where the profile standardises inputs, it is by the given statistics, or else by those of these frames. Without
    `markers` the dots are inpainted.
    """
    pictures = frames.torch(profile.image_size_px, profile.pairing, device, markers=markers)
    if profile.input_standardisation == "none":
        return pictures
    return pictures.standardised(statistics or pictures.channel_statistics())


def one_pass(
    frames: LabelledFrames, profile: Profile, device: torch.device, *key: int
) -> Iterator[tuple[np.ndarray, Tensor]]:
    """Yield shuffled batches, one pass over the frames: which frames (B,) they are, and the network's inputs."""
    pictures = network_inputs(frames, profile, device)
    for indices in epoch_order(len(frames), profile.batch_size, *key):
        yield indices, pictures.inputs(indices)


def normalised_labels(frames: LabelledFrames) -> np.ndarray:
    """Return the labels (n, k) float32, min-max normalised with their ranges to [0, 1]."""
    low, high = frames.labels.low, frames.labels.high
    return ((frames.label_values.astype(np.float32) - low) / (high - low)).astype(np.float32)


@dataclass(frozen=True)
class TrainingDomain:
    """One domain on the device: pictures always, labels only where training may use them.

    force is (n, k), labels normalised to [0, 1]; contact_class (n,); without_markers the same pictures with their dots
    inpainted, where training shows them.
    """

    pictures: PairedFrames
    force: Tensor | None = None
    contact_class: Tensor | None = None
    without_markers: PairedFrames | None = None

    @classmethod
    def labelled(cls, frames: LabelledFrames, profile: Profile, device: torch.device) -> "TrainingDomain":
        """Return the frames with their labels."""
        domain = cls.unlabelled(frames, profile, device)
        force = torch.from_numpy(normalised_labels(frames)).to(device)
        return replace(domain, force=force, contact_class=domain.pictures.contact_class)

    @classmethod
    def unlabelled(cls, frames: LabelledFrames, profile: Profile, device: torch.device) -> "TrainingDomain":
        """Return the frames' pictures alone."""
        pictures = network_inputs(frames, profile, device)
        if profile.marker_hiding == 0:
            return cls(pictures)
        hidden = network_inputs(frames, profile, device, pictures.statistics, markers=False)
        return cls(pictures, without_markers=hidden)

    def inputs(self, rows: Tensor, hidden: bool) -> Tensor:
        """Return the network's inputs (B, C, h, w) for these frames, their markers `hidden` or not."""
        return (self.without_markers if hidden else self.pictures).inputs(rows)

    def __len__(self) -> int:
        return len(self.pictures)
