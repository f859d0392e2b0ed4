"""The training loop: SGD over the epochs of a stage, which can be resumed after each of them."""

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import nn

from gelgap.adapt.checkpoint import load_checkpoint
from gelgap.adapt.diagnosis import EpochLog, EpochRecord, StepResult
from gelgap.adapt.network import ForceNetwork
from gelgap.adapt.profile import Profile
from gelgap.adapt.progress import Progress, silent
from gelgap.adapt.schedules import learning_rate_factor
from gelgap.assets.whole_file import set_aside, whole_file

MAX_SKIPPED_IN_A_ROW = 20
COLLAPSED_SPREAD = 0.05
HEALTHY_SPREAD = 0.3


class FeatureCollapse(RuntimeError):
    """The features no longer tell one force from another: the network predicts a constant."""


class TrainingDiverged(RuntimeError):
    """Losses or gradients were not finite for many steps in a row."""


@dataclass(frozen=True)
class Stage(ABC):
    """What is trained: a network, its batches and its loss.

    Attributes
    ----------
    title
        What progress and errors call the stage.
    network
        Trained in place.
    epochs, learning_rate
        How long, and the initial rate of the heads.
    companion
        A module that is trained along at the heads' rate (a discriminator), or None.
    stops_on_collapse
        Whether `FeatureCollapse` ends a stage whose network has become a constant predictor.
    """

    title: str
    network: ForceNetwork
    profile: Profile
    seed: int
    epochs: int
    learning_rate: float
    stops_on_collapse: ClassVar[bool] = False

    @property
    def companion(self) -> nn.Module | None:
        return None

    @abstractmethod
    def batches(self, epoch: int) -> Iterator[Any]:
        """Yield the batches of an epoch, counted from 0; the same epoch always has the same, so it can be resumed."""

    @abstractmethod
    def step(self, number: int, batch: Any) -> StepResult:
        """Return the loss of a batch; `number` counts the steps over all epochs."""

    def after_step(self) -> None:  # noqa: B027
        """Follow a step that was taken; by default nothing."""

    @property
    def modules(self) -> tuple[nn.Module, ...]:
        """All modules that are trained."""
        return (self.network,) if self.companion is None else (self.network, self.companion)


def train(
    stage: Stage,
    progress: Progress = silent,
    resume_file: Path | None = None,
    watch: Callable[[int], None] | None = None,
) -> list[EpochRecord]:
    """Train a stage's network in place and return the records of its epochs.

    Parameters
    ----------
    resume_file
        Written after every epoch, read at the start if it exists.
    watch
        Called with the number of each finished epoch; it must not change the network.

    Raises
    ------
    TrainingDiverged
        If 20 steps in a row had a loss or gradient that was not finite.
    FeatureCollapse
        If the stage stops on collapse, and a network that told forces apart has become a constant predictor.
    """
    training = _Training(stage)
    if resume_file is not None and resume_file.is_file():
        try:
            training.restore(resume_file)
        except ValueError as error:
            set_aside(resume_file, f"cannot be gone on from ({error})")
            training = _Training(stage)
    for epoch in range(len(training.records), stage.epochs):
        record = training.epoch(epoch)
        if stage.stops_on_collapse:
            _check_collapse(training.records)
        if resume_file is not None:
            training.store(resume_file)
        if watch is not None:
            watch(epoch + 1)
        message = "  ".join(f"{name} {value:.4f}" for name, value in record.losses.items())
        skipped = f"  {record.skipped_steps} steps skipped" if record.skipped_steps else ""
        progress(stage.title, epoch + 1, stage.epochs, message + skipped)
    return training.records


class _Training:
    """A stage in training: its optimiser, the number of steps taken, and the records of its epochs."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self.optimizer = _make_optimizer(stage)
        self.parameters = [p for module in stage.modules for p in module.parameters()]
        self.records: list[EpochRecord] = []
        self.steps = 0
        self.skipped_in_a_row = 0

    def epoch(self, epoch: int) -> EpochRecord:
        stage, log = self.stage, EpochLog()
        stage.network.train()
        for batch in stage.batches(epoch):
            log.batch_is_made()
            for group in self.optimizer.param_groups:
                group["lr"] = group["initial_lr"] * learning_rate_factor(self.steps, stage.profile)
            self.optimizer.zero_grad(set_to_none=True)
            result = stage.step(self.steps, batch)
            result.loss.backward()
            norm = float(
                torch.nn.utils.get_total_norm([p.grad for p in self.parameters if p.grad is not None])
            )
            finite = math.isfinite(norm) and bool(torch.isfinite(result.loss))
            if finite:
                self.optimizer.step()
                stage.after_step()
                self.skipped_in_a_row = 0
            else:
                self._skip(result, norm)
            log.add(result, norm, skipped=not finite)
            self.steps += 1
        self.records.append(log.record(stage.title, epoch + 1))
        return self.records[-1]

    def _skip(self, result: StepResult, norm: float) -> None:
        self.skipped_in_a_row += 1
        if self.skipped_in_a_row >= MAX_SKIPPED_IN_A_ROW:
            values = ", ".join(
                f"{name} = {float(value.detach()):.3g}" for name, value in result.parts.items()
            )
            raise TrainingDiverged(
                f"{self.stage.title}: {self.skipped_in_a_row} steps in a row had a loss or gradient that is not "
                f"finite ({values}, gradient norm {norm:.3g}); lower the learning rate or the transfer weight"
            )

    def store(self, path: Path) -> None:
        companion = self.stage.companion
        content = {
            "network": self.stage.network.state_dict(),
            "companion": None if companion is None else companion.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "records": [asdict(record) for record in self.records],
            "steps": self.steps,
        }
        with whole_file(path) as temporary:
            torch.save(content, temporary)

    def restore(self, path: Path) -> None:
        """Go on from a file that `store` wrote, or raise ValueError and leave the modules as they were."""
        content = load_checkpoint(path)
        before = copy.deepcopy([module.state_dict() for module in self.stage.modules])
        try:
            self.stage.network.load_state_dict(content["network"])
            if self.stage.companion is not None:
                self.stage.companion.load_state_dict(content["companion"])
            self.optimizer.load_state_dict(content["optimizer"])
            self.records = [EpochRecord(**record) for record in content["records"]]
            self.steps = int(content["steps"])
        except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
            for module, state in zip(self.stage.modules, before, strict=True):
                module.load_state_dict(state)
            raise ValueError(
                f"{path} belongs to another training: {' '.join(str(error).split())[:200]}"
            ) from None


def _make_optimizer(stage: Stage) -> torch.optim.SGD:
    """Return SGD with the backbone's learning rate scaled down; a companion learns like the heads."""
    profile, rate = stage.profile, stage.learning_rate
    companion = [] if stage.companion is None else list(stage.companion.parameters())
    groups = [
        {"params": list(stage.network.backbone.parameters()), "lr": rate * profile.backbone_rate_factor},
        {"params": stage.network.head_parameters() + companion, "lr": rate},
    ]
    optimizer = torch.optim.SGD(groups, lr=rate, momentum=profile.momentum, weight_decay=profile.weight_decay)
    for group in optimizer.param_groups:
        group["initial_lr"] = group["lr"]
    return optimizer


def _check_collapse(records: list[EpochRecord]) -> None:
    best, last = max(record.prediction_spread for record in records), records[-1]
    if best >= HEALTHY_SPREAD and last.prediction_spread < COLLAPSED_SPREAD:
        raise FeatureCollapse(
            f"{last.stage}, epoch {last.epoch}: the features collapsed: predictions spread over "
            f"{last.prediction_spread:.1%} of the labels' spread (it was {best:.0%}), effective feature rank "
            f"{last.feature_rank:.1f}; lower transfer_weight (from scratch 0.003 to 0.1, the least for DSAN) or the "
            f"learning rate"
        )
