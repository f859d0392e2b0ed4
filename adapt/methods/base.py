"""What an adaptation method is, what it may work with, and how a training may fail."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from traceback import extract_tb
from typing import ClassVar

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn
from torch.optim import Optimizer

from gelgap.adapt.data import normalised_labels
from gelgap.adapt.model import estimate_statistics
from gelgap.adapt.network import Activations, ForceNetwork
from gelgap.adapt.profile import Profile
from gelgap.assets.settings import Settings
from gelgap.data import LabelledFrames


class FeatureCollapse(RuntimeError):
    """The features no longer tell one force from another: the network predicts a constant."""


class TrainingDiverged(RuntimeError):
    """Losses or gradients are not finite."""


def descend(optimizer: Optimizer, loss: Tensor, what: str) -> None:
    """Take a step of the optimiser on a loss.

    Raises
    ------
    TrainingDiverged
        If the loss is not finite.
    """
    if not torch.isfinite(loss):
        raise TrainingDiverged(f"{what}: the loss is not finite; lower the learning rate")
    optimizer.zero_grad(set_to_none=True)
    loss.backward()
    optimizer.step()


class MethodSettings(Settings):
    """Hyperparameters of one method (frozen); a method that has more declares its own."""

    transfer_weight: float | None = Field(
        default=None, ge=0, description="λ_t at the end of the ramp; by default the profile's"
    )

    def final_weight(self, profile: Profile) -> float:
        """Return λ_t at the end of the ramp."""
        return profile.transfer_weight if self.transfer_weight is None else self.transfer_weight


@dataclass(frozen=True)
class Step:
    """A step of stage 2: its number, counted over all epochs, its λ_t, and its own random numbers.

    The same step of a run always has the same random numbers.
    """

    number: int
    weight: float
    rng: np.random.Generator


@dataclass(frozen=True)
class TransferLoss:
    """What a method adds to a step's loss: weight × value.

    The value is recorded as `transfer`, and so is each of the diagnostics by its name, as means over an epoch.
    """

    value: Tensor
    weight: float
    diagnostics: Mapping[str, float | Tensor] = field(default_factory=dict)


@dataclass(frozen=True)
class Adaptation:
    """What a method without a loss works with while it adapts `network` in place: training frames of both domains.

    Of the target it is given pictures alone, and of the source also the labels, normalised to [0, 1].
    """

    network: ForceNetwork
    profile: Profile
    seed: int
    source: LabelledFrames
    target: LabelledFrames

    def estimate_target_statistics(self) -> None:
        """Replace the batch normalisations' statistics by those of the target's pictures."""
        estimate_statistics(self.network, self.target, self.profile, self.seed)

    def source_mean(self) -> np.ndarray:
        """Return the mean normalised labels (k,) of the source's frames."""
        return normalised_labels(self.source).mean(axis=0)


class Method(nn.Module):
    """A way to adapt a source-trained network to unlabelled target pictures.

    Most methods only give `transfer_loss`; what they own as parameters (a discriminator) is trained along. One that
    applies λ_t in its own way, draws random numbers or records diagnostics gives `loss` instead. One without a loss
    (normalisation statistics, test-time adaptation) overrides `adapt`.

    Attributes
    ----------
    Settings
        The method's hyperparameters.
    uses_target
        Whether it sees target pictures.
    compares_features
        Whether its loss reads the target's activations.
    uses_classifier
        Whether it needs class logits, and so a source with contact classes.
    uses_target_labels
        Whether target labels reach its loss; then it is no method for domain adaptation.
    needs_stage_1
        Whether it starts from the network that stage 1 trained, or from any.
    """

    Settings: ClassVar[type[MethodSettings]] = MethodSettings
    uses_target: ClassVar[bool] = True
    compares_features: ClassVar[bool] = True
    uses_classifier: ClassVar[bool] = False
    uses_target_labels: ClassVar[bool] = False
    needs_stage_1: ClassVar[bool] = True

    def __init__(self, settings: MethodSettings, feature_dim: int, n_classes: int, n_labels: int = 3) -> None:
        super().__init__()
        self.settings = settings
        self.feature_dim = feature_dim
        self.n_classes = n_classes
        self.n_labels = n_labels

    @classmethod
    def check_classes(cls, name: str, source: LabelledFrames) -> None:
        """Raise a ValueError if it needs contact classes, and frames of the source have none, or all the same."""
        if cls.uses_classifier and not source.has_classes:
            raise ValueError(
                f"method {name} needs contact classes, and source {source.name} has frames without one: choose "
                "another method, classes from force (--classes from-force 12), or a source whose frames all have a "
                "class, as `gelgap generate` writes them on the paper's path"
            )
        if cls.uses_classifier and len(np.unique(source.contact_class)) < 2:
            raise ValueError(
                f"method {name} needs source frames of at least 2 contact classes, and the {len(source)} of "
                f"{source.name} are of one: take more frames, or choose another method"
            )

    @property
    def trains(self) -> bool:
        """Whether stage 2 trains the network by the method's loss: unless the method has an `adapt` of its own."""
        return type(self).adapt is Method.adapt

    def adapt(self, adaptation: Adaptation) -> None:
        """Adapt the network in another way; a method that has this is not trained."""

    def augment_source(self, inputs: Tensor, target: Tensor, step: Step) -> Tensor:
        """Return what the network is shown of the source's inputs, the target's (B, channels, h, w) beside them."""
        return inputs

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        """Return the scalar loss, in float32, that stage 2 weighs with λ_t."""
        raise NotImplementedError(f"{type(self).__name__} has neither transfer_loss, loss nor adapt")

    def loss(self, source: Activations, target: Activations, step: Step) -> TransferLoss | None:
        """Return what is added to a step's loss; by default λ_t times `transfer_loss`, and nothing while λ_t is 0."""
        return None if step.weight == 0 else TransferLoss(self.transfer_loss(source, target), step.weight)


def loss_of(method: Method, source: Activations, target: Activations, step: Step) -> TransferLoss | None:
    """Return a method's loss; a RuntimeError names the line of its code that fails, or what is no loss."""
    name = type(method).__name__
    try:
        found = method.loss(source, target, step)
    except (FeatureCollapse, TrainingDiverged):
        raise
    except Exception as error:
        own = [frame for frame in extract_tb(error.__traceback__) if "/torch/" not in frame.filename]
        place = f"line {own[-1].lineno} of {Path(own[-1].filename).name}"
        raise RuntimeError(f"method {name}, {place}: {type(error).__name__}: {error}") from error
    value = getattr(found, "value", None)
    if found is not None and not (isinstance(value, Tensor) and value.numel() == 1):
        value = getattr(value, "shape", value)
        raise RuntimeError(f"method {name}: its loss must be a scalar tensor, and is {value}")
    return found
