"""Pictures whose colours are mixed at random, a stand-in for lights that the source does not show."""

import numpy as np
import torch
from torch import Tensor

from gelgap.adapt.batches import Draw, generator
from gelgap.adapt.profile import Profile


def mix_batch(inputs: Tensor, profile: Profile, *key: int) -> Tensor:
    """Return a source batch with the colours of the profile's share of its frames mixed; the key draws which."""
    if profile.colour_mixing == 0:
        return inputs
    return mix_colours(inputs, profile.colour_mixing, generator(Draw.COLOURS, *key))


def mix_colours(pictures: Tensor, share: float, rng: np.random.Generator) -> Tensor:
    """Turn the colours of a share of network inputs (B, channels, h, w), each by its own rotation or reflection.

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
