"""One training stage: SGD over epochs, with skipped steps counted, collapse diagnosed and every epoch
resumable."""

import contextlib
import ctypes
import functools
import math
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from gelgap.adapt.network import ForceNetwork
from gelgap.adapt.profile import Profile
from gelgap.adapt.progress import Progress
from gelgap.adapt.schedules import learning_rate_factor

MAX_SKIPPED_IN_A_ROW = 20
_M_TRIM_THRESHOLD, _M_TOP_PAD, _M_MMAP_THRESHOLD = -1, -2, -3
COLLAPSED_SPREAD = 0.05
HEALTHY_SPREAD = 0.3


class FeatureCollapse(RuntimeError):
    """The features no longer tell one force from another: the network predicts a constant."""


class TrainingDiverged(RuntimeError):
    """Losses or gradients were not finite for many steps in a row."""


@dataclass(frozen=True)
class EpochRecord:
    """What one epoch did.

    losses holds the mean of each loss; gradient_norm the median norm; prediction_spread the standard
    deviation of the source predictions over that of the source labels (mean over axes; near 0 is a constant
    predictor); feature_rank the effective rank (exponential of the entropy of the normalised singular
    values) of the last batch's centred features; skipped_steps how many steps had a loss or gradient that
    was not finite; wait_s the time spent on making batches out of wall_s; diagnostics what the method
    reports.
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


@dataclass(frozen=True)
class StepResult:
    """One step's weighted loss, its parts for the record, and the source batch's features, predictions and
    labels."""

    loss: Tensor
    parts: dict[str, Tensor]
    features: Tensor
    prediction: Tensor
    force: Tensor


def effective_rank(features: Tensor) -> float:
    """Return exp(−Σ p ln p) with p the normalised singular values of the centred features (n, D) (Roy &
    Vetterli 2007)."""
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


@functools.cache
def keep_freed_memory() -> bool:
    """Have glibc keep freed memory for the next step, and say whether it could be told so.

    By default every activation above 128 kB is mapped and unmapped anew: each page is zeroed again in each step.
    """
    try:
        set_option = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    # 32 MiB is the most that glibc takes as the threshold above which memory is mapped.
    options = {_M_MMAP_THRESHOLD: 2**25, _M_TRIM_THRESHOLD: 2**31 - 1, _M_TOP_PAD: 2**26}
    done = [set_option(option, value) for option, value in options.items()]
    return all(done)


@contextlib.contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Run with so many CPU threads, and without giving memory back between steps."""
    keep_freed_memory()
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def make_optimizer(
    network: ForceNetwork, extra: nn.Module | None, rate: float, profile: Profile
) -> torch.optim.SGD:
    """Return SGD with the backbone's learning rate scaled down; `extra` (a discriminator) learns like the
    heads."""
    heads = network.head_parameters() + ([] if extra is None else list(extra.parameters()))
    groups = [
        {"params": list(network.backbone.parameters()), "lr": rate * profile.backbone_rate_factor},
        {"params": heads, "lr": rate},
    ]
    optimizer = torch.optim.SGD(groups, lr=rate, momentum=profile.momentum, weight_decay=profile.weight_decay)
    for group in optimizer.param_groups:
        group["initial_lr"] = group["lr"]
    return optimizer


def run_stage(
    title: str,
    network: ForceNetwork,
    extra: nn.Module | None,
    epochs: int,
    rate: float,
    profile: Profile,
    batches: Callable[[int], Iterator],
    step: Callable[[int, object], StepResult],
    diagnostics: Callable[[], dict[str, float]],
    progress: Progress,
    resume_file: Path | None,
    watch_collapse: bool,
    watch: Callable[[int], None] | None = None,
) -> list[EpochRecord]:
    """Train in place for some epochs and return their records.

    Parameters
    ----------
    batches
        Maps an epoch to its batches; the same epoch gives the same batches, which is why an epoch can be
        resumed.
    step
        Maps the step's number (over all epochs) and a batch to its loss.
    resume_file
        Written after every epoch, read at the start if it exists.
    watch
        Called with the number of each finished epoch; it must not change the network.

    Raises
    ------
    TrainingDiverged
        If 20 steps in a row had a loss or gradient that was not finite.
    FeatureCollapse
        If `watch_collapse` and a network that told forces apart has become a constant predictor.
    """
    parameters = [*network.parameters(), *([] if extra is None else extra.parameters())]
    optimizer = make_optimizer(network, extra, rate, profile)
    records: list[EpochRecord] = []
    number = 0
    if resume_file is not None and resume_file.is_file():
        records, number = _restore(resume_file, network, extra, optimizer)
    bad_in_a_row = 0
    for epoch in range(len(records), epochs):
        network.train()
        start = ready = time.perf_counter()
        wait = 0.0
        parts: dict[str, list[float]] = {}
        norms: list[float] = []
        skipped = 0
        predictions, labels = [], []
        for batch in batches(epoch):
            wait += time.perf_counter() - ready
            for group in optimizer.param_groups:
                group["lr"] = group["initial_lr"] * learning_rate_factor(number, profile)
            optimizer.zero_grad(set_to_none=True)
            result = step(number, batch)
            result.loss.backward()
            norm = float(torch.nn.utils.get_total_norm([p.grad for p in parameters if p.grad is not None]))
            if math.isfinite(norm) and bool(torch.isfinite(result.loss)):
                optimizer.step()
                bad_in_a_row = 0
                norms.append(norm)
                for name, value in result.parts.items():
                    parts.setdefault(name, []).append(float(value.detach()))
            else:
                skipped += 1
                bad_in_a_row += 1
                if bad_in_a_row >= MAX_SKIPPED_IN_A_ROW:
                    values = ", ".join(
                        f"{name} = {float(value.detach()):.3g}" for name, value in result.parts.items()
                    )
                    raise TrainingDiverged(
                        f"{title}: {bad_in_a_row} steps in a row had a loss or gradient that is not "
                        f"finite ({values}, gradient norm {norm:.3g}); lower the learning "
                        f"rate or the transfer weight"
                    )
            predictions.append(result.prediction.detach().float())
            labels.append(result.force.detach().float())
            number += 1
            ready = time.perf_counter()
        record = EpochRecord(
            stage=title,
            epoch=epoch + 1,
            losses={name: float(np.mean(values)) for name, values in parts.items()},
            gradient_norm=float(np.median(norms)) if norms else math.nan,
            prediction_spread=prediction_spread(torch.cat(predictions), torch.cat(labels)),
            feature_rank=effective_rank(result.features.detach().float()),
            skipped_steps=skipped,
            wall_s=time.perf_counter() - start,
            wait_s=wait,
            diagnostics=diagnostics(),
        )
        records.append(record)
        if watch_collapse:
            _check_collapse(title, records)
        if resume_file is not None:
            _store(resume_file, network, extra, optimizer, records, number)
        if watch is not None:
            watch(epoch + 1)
        message = "  ".join(f"{name} {value:.4f}" for name, value in record.losses.items())
        progress(title, epoch + 1, epochs, message + (f"  {skipped} steps skipped" if skipped else ""))
    return records


def _check_collapse(title: str, records: list[EpochRecord]) -> None:
    best = max(record.prediction_spread for record in records)
    last = records[-1]
    if best >= HEALTHY_SPREAD and last.prediction_spread < COLLAPSED_SPREAD:
        raise FeatureCollapse(
            f"{title}, epoch {last.epoch}: the features collapsed: predictions spread over "
            f"{last.prediction_spread:.1%} of the labels' spread (it was {best:.0%}), effective feature rank "
            f"{last.feature_rank:.1f}; lower transfer_weight (from scratch 0.003 to "
            f"0.1, the least for DSAN) or the learning rate"
        )


def _store(
    path: Path,
    network: nn.Module,
    extra: nn.Module | None,
    optimizer: torch.optim.SGD,
    records: list,
    number: int,
) -> None:
    temporary = path.with_suffix(".part")
    torch.save(
        {
            "network": network.state_dict(),
            "extra": None if extra is None else extra.state_dict(),
            "optimizer": optimizer.state_dict(),
            "records": [asdict(record) for record in records],
            "number": number,
        },
        temporary,
    )
    os.replace(temporary, path)


def _restore(
    path: Path, network: nn.Module, extra: nn.Module | None, optimizer: torch.optim.SGD
) -> tuple[list[EpochRecord], int]:
    content = torch.load(path, map_location=next(network.parameters()).device, weights_only=True)
    network.load_state_dict(content["network"])
    if extra is not None:
        extra.load_state_dict(content["extra"])
    optimizer.load_state_dict(content["optimizer"])
    return [EpochRecord(**record) for record in content["records"]], content["number"]
