"""What an adaptation method is, and what it may work with."""

from collections.abc import Iterator
from typing import ClassVar, Protocol

import numpy as np
from pydantic import Field
from torch import Tensor, nn

from gelgap.adapt.network import Activations, ForceNetwork
from gelgap.adapt.profile import Profile
from gelgap.assets.settings import Settings


class MethodSettings(Settings):
    """Hyperparameters of one method (frozen); a method that has more declares its own."""

    transfer_weight: float | None = Field(
        default=None, ge=0, description="λ_t at the end of the ramp; by default the profile's"
    )

    def final_weight(self, profile: Profile) -> float:
        """Return λ_t at the end of the ramp."""
        return profile.transfer_weight if self.transfer_weight is None else self.transfer_weight


class Adaptation(Protocol):
    """What a method may work with while it adapts `network` in place."""

    network: ForceNetwork

    def train(self, method: "Method") -> None:
        """Run stage 2 with the method's transfer loss."""

    def estimate_target_statistics(self) -> None:
        """Replace the batch normalisations' statistics by those of the target's pictures."""

    def source_mean(self) -> np.ndarray:
        """Return the mean normalised labels (k,) of the source's frames."""

    def source_batches(self, epoch: int) -> Iterator[Tensor]:
        """Yield the network's inputs for the source's frames in shuffled batches, one pass."""

    def labelled_source_batches(self, epoch: int) -> Iterator[tuple[Tensor, Tensor]]:
        """Yield the same with their normalised labels (B, k)."""

    def target_batches(self, epoch: int) -> Iterator[Tensor]:
        """Yield the network's inputs for the target's frames in shuffled batches, one pass."""


class Method(nn.Module):
    """A way to adapt a source-trained network to unlabelled target pictures.

    Most methods only give `transfer_loss`; what they own as parameters (a discriminator) is trained along. A method
    without a loss (normalisation statistics, test-time adaptation) overrides `adapt`.

    Attributes
    ----------
    Settings
        The method's hyperparameters.
    uses_target
        Whether it sees target pictures.
    uses_classifier
        Whether it needs class logits, and so a source with contact classes.
    uses_target_labels
        Whether target labels reach its loss; then it is no method for domain adaptation.
    scheduled
        Whether λ_t and its ramp apply; otherwise λ_t = 1 throughout.
    applies_weight
        Whether `transfer_loss` itself applies λ_t, to a part of the loss or to the gradient that reaches the features;
        it then counts fully, also while λ_t is 0, so that a discriminator learns at the heads' rate.
    weight
        λ_t of the current step.
    rng
        Random numbers of the current step; the same step of a run always has the same.
    needs_stage_1
        Whether it starts from the network that stage 1 trained, or from any.
    diagnostics
        Numbers of the current step that it wants recorded, as means over each epoch.
    """

    Settings: ClassVar[type[MethodSettings]] = MethodSettings
    uses_target: ClassVar[bool] = True
    uses_classifier: ClassVar[bool] = False
    uses_target_labels: ClassVar[bool] = False
    scheduled: ClassVar[bool] = True
    applies_weight: ClassVar[bool] = False
    needs_stage_1: ClassVar[bool] = True

    def __init__(self, settings: MethodSettings, feature_dim: int, n_classes: int) -> None:
        super().__init__()
        self.settings = settings
        self.feature_dim = feature_dim
        self.n_classes = n_classes
        self.weight = 1.0
        self.rng = np.random.default_rng(0)
        self.diagnostics: dict[str, float] = {}

    def adapt(self, adaptation: Adaptation) -> None:
        """Adapt the network; by default stage 2 with this method's transfer loss."""
        adaptation.train(self)

    def begin(self, network: ForceNetwork) -> None:
        """Prepare for stage 2 of a network; by default nothing."""

    def perturb(self, inputs: Tensor) -> Tensor:
        """Return what the network is shown of the target's inputs (B, channels, h, w); by default all as it is."""
        return inputs

    def after_step(self, network: ForceNetwork) -> None:
        """Follow a step of the network in training; by default nothing."""

    def finish(self, network: ForceNetwork) -> None:
        """Turn the network as trained into the result; by default it is the result."""

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        """Return the scalar loss, in float32, that stage 2 weighs with λ_t (see `applies_weight`)."""
        raise NotImplementedError
