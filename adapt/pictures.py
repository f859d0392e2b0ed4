"""Network inputs from uint8 pictures: pairing of contact and reference picture, on the device, without a
data loader."""

import numpy as np
import torch
from torch import Tensor

from gelgap.adapt.frames import Frames
from gelgap.adapt.profile import Profile

_IMAGENET_MEAN = (0.485, 0.456, 0.406)
_IMAGENET_STD = (0.229, 0.224, 0.225)
_DIFFERENCE_GAIN = 4.0
"""Pressing changes a channel by a tenth or two of its range; the gain brings the input near unit size."""


class Pictures:
    """The pictures of one domain as a uint8 tensor on the device; `batch` makes normalised network inputs
    of some.

    Pictures stay uint8 until they are used: a domain of 10,830 frames at 256 px takes 2.1 GB, so that it
    fits in the memory of the machine or the card and no step waits for data.
    """

    def __init__(self, frames: Frames, profile: Profile, device: torch.device | str = "cpu") -> None:
        self.pairing = profile.pairing
        self.images = torch.from_numpy(frames.images).to(device)
        self.mean = torch.tensor(_IMAGENET_MEAN, device=device).view(1, 3, 1, 1)
        self.std = torch.tensor(_IMAGENET_STD, device=device).view(1, 3, 1, 1)
        self.reference = self._scale(torch.from_numpy(frames.reference[None].copy()).to(device))

    def __len__(self) -> int:
        return len(self.images)

    @staticmethod
    def _scale(images: Tensor) -> Tensor:
        return images.permute(0, 3, 1, 2).float() / 255

    def batch(self, indices: np.ndarray | Tensor) -> Tensor:
        """Return the inputs (B, channels, h, w) float32 of these frames, channels last in memory."""
        images = self._scale(self.images[torch.as_tensor(indices, device=self.images.device)])
        if self.pairing == "difference":
            pictures = (images - self.reference) * _DIFFERENCE_GAIN
        else:
            images = (images - self.mean) / self.std
            reference = ((self.reference - self.mean) / self.std).expand_as(images)
            pictures = torch.cat([images, reference], dim=1 if self.pairing == "channels" else 2)
        return pictures.contiguous(memory_format=torch.channels_last)


def mix_colours(pictures: Tensor, share: float, rng: np.random.Generator) -> Tensor:
    """Turn the colours of a random share of network inputs (B, channels, h, w) by a random rotation or reflection.

    Under lamps of other colours in other places each channel sees the membrane's slopes along other directions; mixed
    channels show a network many such lights, so that it must read forces from what they share.
    """
    chosen = torch.from_numpy(rng.random(len(pictures)) < share).to(pictures.device)
    turns, _ = np.linalg.qr(rng.standard_normal((len(pictures), 3, 3)))
    turns = torch.from_numpy(turns.astype(np.float32)).to(pictures.device)
    matrices = torch.where(chosen[:, None, None], turns, torch.eye(3, device=pictures.device))
    colours = pictures.unflatten(1, (-1, 3))
    mixed = torch.einsum("nij,ngjhw->ngihw", matrices, colours).flatten(1, 2)
    return mixed.contiguous(memory_format=torch.channels_last)
