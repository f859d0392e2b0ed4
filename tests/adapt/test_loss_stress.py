"""Losses on degenerate batches: value and gradient are finite, exact in float32, and 0 where they should be."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from gelgap.adapt.methods.cod import conditional_mmd, conditional_operator_discrepancy
from gelgap.adapt.methods.coral import coral
from gelgap.adapt.methods.dan import bandwidth, joint_mmd, mk_mmd, multi_gaussian, squared_distances
from gelgap.adapt.methods.dann import DANN, domain_loss
from gelgap.adapt.methods.daregram import daregram, daregram_published, daregram_tikhonov
from gelgap.adapt.methods.dsan import lmmd
from gelgap.adapt.methods.rsd import projection_distance

BATCH, FEATURES, CLASSES = 32, 256, 361
OUTLIER = 1e4


def adversarial(source: Tensor, target: Tensor) -> Tensor:
    torch.manual_seed(0)
    discriminator = DANN(DANN.Settings(), source.shape[1], n_classes=1).discriminator.to(source.dtype)
    logits = discriminator(torch.cat([source, target]))[:, 0]
    return domain_loss(logits[: len(source)], logits[len(source) :])


def subdomains(source: Tensor, target: Tensor, robust: bool = False, shift: int = 0) -> Tensor:
    """Return LMMD where frame i is of class i modulo 20; a shift leaves the domains no class in common."""
    of_source, of_target = torch.zeros(len(source), CLASSES), torch.zeros(len(target), CLASSES)
    of_source[torch.arange(len(source)), torch.arange(len(source)) % 20] = 1
    of_target[torch.arange(len(target)), torch.arange(len(target)) % 20 + shift] = 1
    return lmmd(source, target, of_source.to(source), of_target.to(target), robust=robust)


def conditional(source: Tensor, target: Tensor, operators: bool) -> Tensor:
    force = torch.from_numpy(np.random.default_rng(3).random((len(source) + len(target), 3)))
    distances = squared_distances(torch.cat([source, target]))
    kernel = multi_gaussian(distances, bandwidth(distances, robust=False))
    of_source, of_target = force[: len(source)], force[len(source) :]
    if operators:
        return conditional_operator_discrepancy(kernel, of_source, of_target, 0.05)
    return conditional_mmd(kernel, of_source, of_target, 0.1, 0.01)


LOSSES = {
    "dann": adversarial,
    "coral": coral,
    "dan": mk_mmd,
    "dan, median": lambda s, t: mk_mmd(s, t, robust=True),
    "jan": lambda s, t: joint_mmd((s, s[:, :3]), (t, t[:, :3])),
    "dsan": subdomains,
    "dsan, median": lambda s, t: subdomains(s, t, robust=True),
    "dsan, no common class": lambda s, t: subdomains(s, t, shift=100),
    "cod": lambda s, t: conditional(s, t, operators=True),
    "conditional-mmd": lambda s, t: conditional(s, t, operators=False),
    "rsd": projection_distance,
    "daregram": lambda s, t: daregram(s, t, 0.5, 0.003, 0.9),
    "daregram-tikhonov": lambda s, t: daregram_tikhonov(s, t, 0.5, 0.003, 0.01),
}
# The discriminator's loss is ln 2 where it cannot tell the domains apart; cod and conditional-mmd are of features and
# forces, which are drawn apart for both domains.
NEVER_ZERO = ("dann", "cod", "conditional-mmd")


def traps() -> dict[str, tuple[Tensor, Tensor]]:
    """Return pairs of batches in float32 on which losses go wrong; the first is an ordinary one."""
    generator = torch.Generator().manual_seed(0)
    s = torch.rand(BATCH, FEATURES, generator=generator)
    t = torch.rand(BATCH, FEATURES, generator=generator) * 1.3
    outlier = t.clone()
    outlier[0] = OUTLIER
    wide = torch.rand(2 * FEATURES, FEATURES, generator=generator)
    units = torch.arange(FEATURES)
    return {
        "random": (s, t),
        "identical": (s, s.clone()),
        "permuted rows": (s, s.flip(0)),
        "constant": (torch.ones_like(s), 2 * torch.ones_like(s)),
        "all zero": (torch.zeros_like(s), torch.zeros_like(s)),
        "duplicated rows": (s[: BATCH // 2].repeat(2, 1), t),
        "repeated singular values": (torch.eye(BATCH, FEATURES), torch.eye(BATCH, FEATURES).roll(9, 1)),
        "batch > dimension": (wide, 1.3 * wide.flip(1)),
        "dead units": (s * (units > 99), t * (units > 49)),
        "one outlier at 1e4": (s, outlier),
        "offset 1e4": (s + OUTLIER, t + OUTLIER),
        "unequal batches": (s, t[:13]),
        "scale 1e-6": (1e-6 * s, 1e-6 * t),
        "scale 1e6": (1e6 * s, 1e6 * t),
        "bfloat16 features": (s.bfloat16().float(), t.bfloat16().float()),
    }


def should_be_zero(loss: str, trap: str) -> bool:
    equal = ("identical", "all zero", *(["permuted rows"] if "dsan" not in loss else []))
    # A constant batch has no covariance; its multiple spans the same line.
    flat = trap == "constant" and loss in ("coral", "rsd")
    return loss == "dsan, no common class" or flat or (trap in equal and loss not in NEVER_ZERO)


KNOWN_LIMIT = ("daregram", "repeated singular values")
"""Where all singular values are equal, no cut of the spectrum lies in a gap, and which vectors it keeps is a matter of
rounding; the published form jumps alike, and daregram-tikhonov cuts nothing."""


CASES = [(loss, trap) for loss in LOSSES for trap in traps() if (loss, trap) != KNOWN_LIMIT]


@pytest.mark.parametrize(("loss", "trap"), CASES)
def test_value_and_gradient_in_a_trap(loss, trap):
    source, target = traps()[trap]
    source = source.clone().requires_grad_(True)
    if (loss, trap) == ("rsd", "batch > dimension"):
        with pytest.raises(ValueError, match="spans all"):
            LOSSES[loss](source, target)
        return
    value = LOSSES[loss](source, target)
    value.backward()
    value, exact = value.item(), LOSSES[loss](source.detach().double(), target.double()).item()
    assert math.isfinite(value)
    assert torch.isfinite(source.grad).all()
    if should_be_zero(loss, trap):
        assert abs(value) < 1e-4
    else:
        assert value != 0
        assert abs(value - exact) < 1e-2 * max(abs(exact), 1e-3)


def test_a_known_limit_is_a_jump_of_the_published_form_too_and_not_of_the_ridge():
    """Changes of 1e-9, far above rounding, so that no processor's rounding decides which side of a jump is seen."""
    source, target = (batch.double() for batch in traps()[KNOWN_LIMIT[1]])

    def relative_spread(loss) -> float:
        values = []
        for seed in range(6):
            generator = torch.Generator().manual_seed(seed)
            noise = torch.randn(source.shape, generator=generator, dtype=torch.float64)
            values.append(float(loss(source + 1e-9 * noise, target)))
        return (max(values) - min(values)) / max(values)

    assert relative_spread(LOSSES["daregram"]) > 1e-4
    assert relative_spread(lambda s, t: daregram_published(s, t, 0.5, 0.003, 0.9)) > 1e-4
    assert relative_spread(LOSSES["daregram-tikhonov"]) < 1e-7
