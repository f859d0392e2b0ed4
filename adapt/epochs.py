"""Epochs of a training: what each did, whether the features still tell forces apart, and the progress that is shown."""

import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from gelgap.adapt.network import Activations

Progress = Callable[[str, int, int, str], None]
"""Called after every epoch with the stage's title, the epochs done, the epochs in all, and a short message."""


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

    def __str__(self) -> str:
        skipped = f"  {self.skipped_steps} steps skipped" if self.skipped_steps else ""
        return "  ".join(f"{name} {value:.4f}" for name, value in self.losses.items()) + skipped


class EpochLog:
    """Collects the steps of one epoch, on the device; `record` sums them up."""

    def __init__(self) -> None:
        self._start = self._step_end = time.perf_counter()
        self._wait_s = 0.0
        self._steps: list[tuple[Mapping[str, Tensor], Mapping[str, float | Tensor], Tensor]] = []
        self._predictions: list[Tensor] = []
        self._labels: list[Tensor] = []

    def batch_is_made(self) -> None:
        """Note that the loop has got its next batch."""
        self._wait_s += time.perf_counter() - self._step_end

    def add(
        self,
        source: Activations,
        losses: Mapping[str, Tensor],
        diagnostics: Mapping[str, float | Tensor] | None,
        gradient_norm: Tensor | None,
    ) -> None:
        """Note a step; losses and diagnostics of a skipped one, which has no gradient_norm, are left out."""
        if gradient_norm is not None:
            losses = {name: loss.detach() for name, loss in losses.items()}
            self._steps.append((losses, diagnostics or {}, gradient_norm))
        self._predictions.append(source.prediction.detach().float())
        self._labels.append(source.force.detach().float())
        self._features = source.features.detach().float()
        self._step_end = time.perf_counter()

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
            wait_s=self._wait_s,
            diagnostics=_means(diagnostics),
        )


def _means(steps: tuple[Mapping[str, float | Tensor], ...]) -> dict[str, float]:
    """Return the mean of each number over the steps that have it."""
    names = dict.fromkeys(name for step in steps for name in step)
    return {name: float(np.mean([float(step[name]) for step in steps if name in step])) for name in names}


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


def silent(title: str, done: int, total: int, message: str) -> None:
    """Say nothing."""


@contextmanager
def console_progress() -> Iterator[Progress]:
    """Yield a `Progress` that writes to stderr: a bar on a terminal, plain lines elsewhere."""
    if not sys.stderr.isatty():
        yield _print_some
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), "{task.fields[message]}")
    with Bars("{task.description}", *columns, console=Console(file=sys.stderr)) as bars:
        tasks = {}

        def advance(title: str, done: int, total: int, message: str) -> None:
            if title not in tasks:
                tasks[title] = bars.add_task(title, total=total, message="")
            bars.update(tasks[title], completed=done, message=message)

        yield advance


def _print_some(title: str, done: int, total: int, message: str) -> None:
    """Print a line for every fifth of the epochs."""
    if done == total or done % max(1, total // 5) == 0:
        print(f"{title}: epoch {done}/{total}  {message}", file=sys.stderr, flush=True)
