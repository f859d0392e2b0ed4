"""What an epoch did: losses, gradients, and whether the features still tell one force from another."""

import math
import time
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from gelgap.adapt.network import Activations


@dataclass(frozen=True)
class StepResult:
    """A step's loss, its parts by name (not weighted), the source batch's activations, and the method's diagnostics."""

    loss: Tensor
    parts: dict[str, Tensor]
    source: Activations
    diagnostics: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class EpochRecord:
    """What one epoch did.

    Attributes
    ----------
    losses
        Mean of each loss.
    gradient_norm
        Median norm of the gradient.
    prediction_spread
        Standard deviation of the source predictions over that of their labels, mean over axes; near 0 the network
        predicts a constant.
    feature_rank
        Effective rank of the last source batch's features.
    skipped_steps
        Steps whose loss or gradient was not finite.
    wall_s, wait_s
        Time of the epoch, and the part of it spent on making batches.
    diagnostics
        Mean of each number that the method reports, over the steps that were not skipped.
    """

    stage: str
    epoch: int
    losses: dict[str, float]
    gradient_norm: float
    prediction_spread: float
    feature_rank: float
    skipped_steps: int
    wall_s: float
    wait_s: float
    diagnostics: dict[str, float] = field(default_factory=dict)


class EpochLog:
    """Collects the steps of one epoch; `record` sums them up."""

    def __init__(self) -> None:
        self._start = self._step_end = time.perf_counter()
        self._wait_s = 0.0
        self._losses: dict[str, list[float]] = {}
        self._diagnostics: dict[str, list[float]] = {}
        self._norms: list[float] = []
        self._predictions: list[Tensor] = []
        self._labels: list[Tensor] = []
        self.skipped_steps = 0

    def batch_is_made(self) -> None:
        """Note that the loop has got its next batch."""
        self._wait_s += time.perf_counter() - self._step_end

    def add(self, result: StepResult, gradient_norm: float, skipped: bool) -> None:
        """Note a step; losses, gradient and diagnostics of a skipped one are left out."""
        if skipped:
            self.skipped_steps += 1
        else:
            self._norms.append(gradient_norm)
            for name, value in result.parts.items():
                self._losses.setdefault(name, []).append(float(value.detach()))
            for name, value in result.diagnostics.items():
                self._diagnostics.setdefault(name, []).append(value)
        self._predictions.append(result.source.prediction.detach().float())
        self._labels.append(result.source.force.detach().float())
        self._features = result.source.features.detach().float()
        self._step_end = time.perf_counter()

    def record(self, stage: str, epoch: int) -> EpochRecord:
        """Return what the epoch did."""
        return EpochRecord(
            stage=stage,
            epoch=epoch,
            losses=_means(self._losses),
            gradient_norm=float(np.median(self._norms)) if self._norms else math.nan,
            prediction_spread=prediction_spread(torch.cat(self._predictions), torch.cat(self._labels)),
            feature_rank=effective_rank(self._features),
            skipped_steps=self.skipped_steps,
            wall_s=time.perf_counter() - self._start,
            wait_s=self._wait_s,
            diagnostics=_means(self._diagnostics),
        )


def _means(values: dict[str, list[float]]) -> dict[str, float]:
    return {name: float(np.mean(some)) for name, some in values.items()}


def effective_rank(features: Tensor) -> float:
    """Return exp(−Σ p ln p), p the normalised singular values of the centred features (n, D) [1].

    [1] Roy, Vetterli, "The effective rank: a measure of effective dimensionality", EUSIPCO 2007.
    """
    values = torch.linalg.svdvals((features - features.mean(dim=0)).double())
    total = values.sum()
    if total == 0:
        return 0.0
    shares = values[values > 0] / total
    return float(torch.exp(-(shares * shares.log()).sum()))


def prediction_spread(prediction: Tensor, force: Tensor) -> float:
    """Return the mean over axes of std(prediction) / std(force); axes with constant labels are left out."""
    label_std = force.std(dim=0)
    varies = label_std > 1e-6
    if not varies.any():
        return math.nan
    return float((prediction.std(dim=0)[varies] / label_std[varies]).mean())
