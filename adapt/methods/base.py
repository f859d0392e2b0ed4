"""The contract of adaptation methods: what one is given, what it returns, and how a training may fail."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Protocol, cast

import numpy as np
from pydantic import Field
from torch import Tensor, nn

from gelgap.assets.settings import Settings


class FeatureCollapse(RuntimeError):
    """The features no longer tell one force from another: the network predicts a constant."""


class TrainingDiverged(RuntimeError):
    """Losses or gradients are not finite."""


class MethodSettings(Settings):
    """Hyperparameters of one method (frozen); a method that has more declares its own."""

    transfer_weight: float | None = Field(
        default=None, ge=0, description="λ_t at the end of the ramp; by default the profile's"
    )


@dataclass(frozen=True)
class Activations:
    """The network's output for a batch of B frames of one domain, and their known labels.

    inputs (B, channels, h, w); features (B, D) after the bottleneck's ReLU, prediction
    (B, k) in [0, 1], logits (B, C) where the method uses the classifier; force (B, k) in [0, 1] and contact_class (B,)
    only where labels may be used. k is 3, the axes of the force, unless a run has other labels; these take their place.
    """

    features: Tensor
    prediction: Tensor
    logits: Tensor | None = None
    force: Tensor | None = None
    contact_class: Tensor | None = None
    inputs: Tensor | None = None


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


class Pictures(Protocol):
    """The pictures of a domain's training frames as the network is shown them."""

    def inputs(self, rows: np.ndarray | Tensor) -> Tensor:
        """Return inputs (B, channels, h, w) float32 of these frames, by their numbers."""

    def __len__(self) -> int: ...


@dataclass(frozen=True)
class Adaptation:
    """What a method without a loss works with while it adapts a network in place.

    Of the target it is given pictures alone.

    Attributes
    ----------
    network
        The network of stage 1: `features(inputs)` gives (B, D), `regressor(features)` the labels (B, k) in [0, 1].
    seed
        The run's, for random numbers.
    source_pictures, target_pictures
        Give the pictures of a domain's training frames.
    source_labels
        Labels (n, k) of the source's training frames, normalised to [0, 1].
    estimate_target_statistics
        Replaces the batch normalisations' statistics by those of the target's pictures.
    """

    network: nn.Module
    seed: int
    source_pictures: Callable[[], Pictures]
    target_pictures: Callable[[], Pictures]
    source_labels: np.ndarray
    estimate_target_statistics: Callable[[], None]


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

    @property
    def trains(self) -> bool:
        """Whether stage 2 trains the network by the method's loss: unless the method has an `adapt` of its own."""
        return type(self).adapt is Method.adapt

    def adapt(self, adaptation: Adaptation) -> None:
        """Adapt the network in another way; a method that has this is not trained."""

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        """Return the scalar loss, in float32, that stage 2 weighs with λ_t."""
        raise NotImplementedError(f"{type(self).__name__} has neither transfer_loss, loss nor adapt")

    def loss(self, source: Activations, target: Activations, step: Step) -> TransferLoss | None:
        """Return what is added to a step's loss; by default λ_t times `transfer_loss`, and nothing while λ_t is 0."""
        return None if step.weight == 0 else TransferLoss(self.transfer_loss(source, target), step.weight)


def loss_of(
    method: Method, source: Activations, target: Activations | None, step: Step
) -> TransferLoss | None:
    """Return a method's loss; a RuntimeError says what in its code fails, or what is no loss."""
    name = type(method).__name__
    try:
        # One that does not compare features is given none of the target's.
        added = method.loss(source, cast(Activations, target), step)
    except (FeatureCollapse, TrainingDiverged):
        raise
    except Exception as error:
        raise RuntimeError(f"method {name}: {type(error).__name__}: {error}") from error
    if added is None:
        return None
    value = getattr(added, "value", None)
    if not (isinstance(value, Tensor) and value.numel() == 1):
        value = getattr(value, "shape", value)
        raise RuntimeError(f"method {name}: its loss must be a scalar tensor, and is {value}")
    return added
