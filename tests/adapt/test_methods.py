"""What a method owns begins by the seed of its run; and baselines without a network."""

import numpy as np
import pytest
import torch

from gelgap.adapt import Method, Profile
from gelgap.adapt.evaluation import BASELINES, CONSTANT, evaluate_baselines
from gelgap.adapt.methods.base import MethodSettings, Step, loss_of
from gelgap.adapt.methods.registry import make_method
from gelgap.adapt.split import SplitFrames
from gelgap.data import ArrayFrames


def presses(name: str, depth: np.ndarray, tint=(1.0, 0.8, 0.6), seed: int = 0) -> ArrayFrames:
    """Pictures of dents whose area and contrast grow with the depth, which is the force."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:32, :40].astype(float)
    images = np.full((len(depth), 32, 40, 3), 128, np.uint8)
    for image, own in zip(images, depth, strict=True):
        dent = own * np.exp(-((x - 20) ** 2 + (y - 16) ** 2) / (2 * (2 + 4 * own) ** 2))
        image[:] = 128 + 80 * dent[..., None] * np.array(tint) + rng.normal(0, 1, image.shape)
    force_n = np.stack([0 * depth, 0 * depth, -2.5 * depth], axis=1)
    return ArrayFrames(name, images, np.full((32, 40, 3), 128, np.uint8), force_n)


def test_what_a_method_owns_begins_by_the_runs_seed():
    first, same, other = (
        make_method("dann", Profile.preset("smoke"), 10, 3, seed).discriminator[1].weight
        for seed in (0, 0, 1)
    )
    assert torch.equal(first, same)
    assert not torch.equal(first, other)


class Own(Method):
    def transfer_loss(self, source, target):
        return source / target


@pytest.mark.parametrize(
    ("source", "message"),
    [
        (None, "^method Own: TypeError: unsupported operand"),
        (3.0, "^method Own: its loss must be a scalar tensor, and is 1.5"),
        (torch.ones(4), r"a scalar tensor, and is torch.Size\(\[4\]\)"),
    ],
)
def test_a_method_that_fails_is_named(source: object, message: str) -> None:
    with pytest.raises(RuntimeError, match=message):
        loss_of(Own(MethodSettings(), 8, 4), source, 2.0, Step(0, 1.0, np.random.default_rng(0)))


def test_rules_beat_the_constant_where_area_tells_the_force() -> None:
    rng = np.random.default_rng(0)
    source = presses("one", rng.uniform(0.1, 1, 48))
    target = presses("other", rng.uniform(0.1, 1, 48), (0.6, 0.8, 1.0), 1)
    bright = presses("bright", np.random.default_rng(2).uniform(0.1, 1, 40), (1.0, 0.8, 0.6), 3)
    found = evaluate_baselines(SplitFrames(source, source.take(np.arange(0)), target, target, bright))
    assert tuple(found) == BASELINES
    assert found[CONSTANT].mae[2] > 3 * found["quadratic in mean difference"].mae[2]
    assert found[CONSTANT].mae[2] > 3 * found["ridge on area and depth"].mae[2]
    assert found["ridge on area and depth"].r2[2] > 0.9
