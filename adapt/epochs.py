"""What an epoch of training did, summed up from its steps, and the sign that features have collapsed."""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from gelgap.adapt.methods.base import Activations, FeatureCollapse
from gelgap.adapt.selection import effective_rank

COLLAPSED_SPREAD = 0.05
HEALTHY_SPREAD = 0.3


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
    wall_s
        Time of the epoch.
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
    diagnostics: dict[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        skipped = f"  {self.skipped_steps} steps skipped" if self.skipped_steps else ""
        return "  ".join(f"{name} {value:.4f}" for name, value in self.losses.items()) + skipped


class EpochLog:
    """Collects the steps of one epoch, on the device; `record` sums them up."""

    def __init__(self) -> None:
        self._start = time.perf_counter()
        self._steps: list[tuple[Mapping[str, Tensor], Mapping[str, float | Tensor], Tensor]] = []
        self._predictions: list[Tensor] = []
        self._labels: list[Tensor] = []

    def add(
        self,
        source: Activations,
        losses: Mapping[str, Tensor],
        diagnostics: Mapping[str, float | Tensor] | None,
        gradient_norm: Tensor | None,
    ) -> None:
        """Note a step; losses and diagnostics of a skipped one, which has no gradient_norm, are left out."""
        assert source.force is not None, "source frames have labels"
        if gradient_norm is not None:
            losses = {name: loss.detach() for name, loss in losses.items()}
            self._steps.append((losses, diagnostics or {}, gradient_norm))
        self._predictions.append(source.prediction.detach().float())
        self._labels.append(source.force.detach().float())
        self._features = source.features.detach().float()

    def record(self, stage: str, epoch: int) -> EpochRecord:
        """Return what the epoch did."""
        losses, diagnostics, norms = zip(*self._steps, strict=True) if self._steps else ((), (), ())
        return EpochRecord(
            stage=stage,
            epoch=epoch,
            losses=_means(losses),
            gradient_norm=float(np.median([float(norm) for norm in norms])) if norms else math.nan,
            prediction_spread=prediction_spread(torch.cat(self._predictions), torch.cat(self._labels)),
            feature_rank=effective_rank(self._features),
            skipped_steps=len(self._predictions) - len(self._steps),
            wall_s=time.perf_counter() - self._start,
            diagnostics=_means(diagnostics),
        )


def _means(steps: tuple[Mapping[str, float | Tensor], ...]) -> dict[str, float]:
    """Return the mean of each number over the steps that have it."""
    names = dict.fromkeys(name for step in steps for name in step)
    return {name: float(np.mean([float(step[name]) for step in steps if name in step])) for name in names}


def prediction_spread(prediction: Tensor, force: Tensor) -> float:
    """Return the mean over axes of std(prediction) / std(force); axes with constant labels are left out (all: NaN)."""
    label_std = force.std(dim=0)
    varies = label_std > 1e-6
    return float((prediction.std(dim=0)[varies] / label_std[varies]).mean())


def check_collapse(records: list[EpochRecord]) -> None:
    """Raise FeatureCollapse if the predictions of the last epoch hardly vary, and those of one before did."""
    best = max(record.prediction_spread for record in records)
    last = records[-1]
    if best >= HEALTHY_SPREAD and last.prediction_spread < COLLAPSED_SPREAD:
        raise FeatureCollapse(
            f"{last.stage}, epoch {last.epoch}: the features collapsed: predictions spread over "
            f"{last.prediction_spread:.1%} of the labels' spread (it was {best:.0%}), effective feature rank "
            f"{last.feature_rank:.1f}; lower transfer_weight (from scratch 0.003 to 0.1, the least for DSAN) or the "
            f"learning rate"
        )
