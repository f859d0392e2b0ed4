"""Schedules of the learning rate and of the transfer weight."""

import math

from gelgap.adapt.profile import Profile


def learning_rate_factor(step: int, profile: Profile) -> float:
    """Return (1 + a·step)^−b, the paper's schedule (section IV-B)."""
    return (1 + profile.rate_decay * step) ** -profile.rate_power


def transfer_factor(step: int, steps: int, profile: Profile) -> float:
    """Return the factor in [0, 1] on λ_t: 0 in the warm-up, then 2/(1+e^(−γp))−1 with p from 0 to 1 [1].

    [1] Ganin, Lempitsky, "Unsupervised domain adaptation by backpropagation", ICML 2015, section 4.
    """
    progress = step / max(steps - 1, 1)
    if progress < profile.transfer_warmup:
        return 0.0
    if profile.transfer_ramp == 0:
        return 1.0
    p = (progress - profile.transfer_warmup) / (1 - profile.transfer_warmup)
    return 2 / (1 + math.exp(-profile.transfer_ramp * p)) - 1
