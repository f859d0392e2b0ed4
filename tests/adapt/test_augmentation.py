"""Training pictures changed at random: colours are turned, pictures shifted, and the same draws come again."""

import numpy as np
import pytest
import torch
from network_weights import weights

from gelgap.adapt.data import mix_colours, shift_pictures
from gelgap.adapt.trainer import train_source


def test_mixed_colours_are_turned_not_stretched():
    pictures = torch.rand(40, 6, 5, 7, generator=torch.Generator().manual_seed(0))
    mixed = mix_colours(pictures, 0.5, np.random.default_rng(0))
    length = [p.unflatten(1, (-1, 3)).square().sum(dim=2) for p in (pictures, mixed)]
    torch.testing.assert_close(*length)
    same = (mixed == pictures).flatten(1).all(dim=1)
    assert 10 < int(same.sum()) < 30
    torch.testing.assert_close(mix_colours(pictures, 0.0, np.random.default_rng(0)), pictures)


def test_training_with_mixed_colours_is_deterministic(source, profile):
    mixing = profile.replace(source_epochs=2, colour_mixing=0.5)
    first, second = (train_source(source, mixing, seed=0) for _ in range(2))
    np.testing.assert_array_equal(weights(first), weights(second))
    plain = train_source(source, mixing.replace(colour_mixing=0.0), seed=0)
    assert np.abs(weights(first) - weights(plain)).max() > 1e-3


def test_shifted_pictures_are_the_same_ones_elsewhere():
    rng = np.random.default_rng(0)
    pictures = torch.rand(6, 3, 20, 24).contiguous(memory_format=torch.channels_last)
    shifted = shift_pictures(pictures, 3, rng)
    assert shifted.shape == pictures.shape
    offsets = set()
    for one, other in zip(pictures, shifted, strict=True):
        (found,) = [
            (x, y)
            for x in range(-3, 4)
            for y in range(-3, 4)
            if torch.equal(one[:, 5 + y : 13 + y, 5 + x : 13 + x], other[:, 5:13, 5:13])
        ]
        offsets.add(found)
    assert len(offsets) > 3, "each by its own way"


def test_training_with_shifts_is_deterministic(source, profile):
    shifting = profile.replace(source_epochs=2, shift_px=3)
    first, second = (train_source(source, shifting, seed=0) for _ in range(2))
    np.testing.assert_array_equal(weights(first), weights(second))
    plain = train_source(source, shifting.replace(shift_px=0), seed=0)
    assert np.abs(weights(first) - weights(plain)).max() > 1e-3
    with pytest.raises(ValueError, match="shift_px: must be 0 with pairing 'stack'"):
        profile.replace(shift_px=3, pairing="stack")
