"""Pictures shifted at random, a stand-in for contacts at points that the source does not show."""

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from gelgap.adapt.batches import Draw, generator
from gelgap.adapt.profile import Profile


def shift_batch(inputs: Tensor, profile: Profile, *key: int) -> Tensor:
    """Return a batch whose pictures are shifted by up to the profile's number of pixels; the key draws how far."""
    if profile.shift_px == 0:
        return inputs
    return shift_pictures(inputs, profile.shift_px, generator(Draw.SHIFTS, *key))


def shift_pictures(pictures: Tensor, most_px: int, rng: np.random.Generator) -> Tensor:
    """Shift network inputs (B, channels, h, w), each along x and y by its own whole number of pixels up to `most_px`.

    Contact and reference are shifted together, and their edges are continued. A network that has seen few contact
    points takes the light at each of them for the force; the same contact elsewhere shows it what the force does.
    """
    height, width = pictures.shape[2:]
    padded = functional.pad(pictures, (most_px,) * 4, mode="replicate")
    offsets = rng.integers(0, 2 * most_px + 1, (len(pictures), 2)).tolist()
    shifted = [padded[k, :, y : y + height, x : x + width] for k, (x, y) in enumerate(offsets)]
    return torch.stack(shifted).contiguous(memory_format=torch.channels_last)
