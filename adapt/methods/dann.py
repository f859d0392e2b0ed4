"""A domain discriminator on the features, whose gradient is reversed (DANN, CDAN).

DANN [1]: the loss and its reversal are tllib's. Deviations: the discriminator is narrower (128, not 1024), sees the
joint batch and standardises its input instead of its hidden layers; λ_t ends at the method's weight, not at 1.

CDAN [2]: the published discriminator sees the outer product of feature and class probabilities. Forces have no classes:
here it is the outer product of the feature with (1, F̂), F̂ the normalised force (or other labels) without gradient, so
that it sees the feature itself and how it goes with each axis. Entropy conditioning (CDAN+E) needs probabilities and is
left out.

[1] Ganin et al., "Domain-adversarial training of neural networks", JMLR 17, 2016.
[2] Long, Cao, Wang, Jordan, "Conditional adversarial domain adaptation", NeurIPS 2018.
"""

import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from gelgap.adapt.methods.base import Activations, Method, MethodSettings, Step, TransferLoss


def reverse_gradient(features: Tensor, weight: float) -> Tensor:
    """Return the features unchanged; the gradient that flows back is multiplied by −weight ([1], section 4.2)."""
    same = features.view_as(features)
    if same.requires_grad:
        same.register_hook(lambda gradient: -weight * gradient)
    return same


def domain_loss(logits_source: Tensor, logits_target: Tensor) -> Tensor:
    """Return ½[BCE(D(f_s), 1) + BCE(D(f_t), 0)] of discriminator logits.

    With the best discriminator it is ln 2 less the Jensen–Shannon divergence of the two feature distributions.
    """
    source = functional.binary_cross_entropy_with_logits(logits_source, torch.ones_like(logits_source))
    target = functional.binary_cross_entropy_with_logits(logits_target, torch.zeros_like(logits_target))
    return (source + target) / 2


class DANN(Method):
    """Regression with a domain-adversarial loss on the transfer feature.

    λ_t scales the reversed gradient alone: the discriminator learns at the heads' rate, from the first step on.
    """

    class Settings(MethodSettings):
        hidden: int = Field(default=128, ge=1, description="width of the discriminator's two hidden layers")

    def __init__(self, settings: Settings, feature_dim: int, n_classes: int, n_labels: int = 3) -> None:
        super().__init__(settings, feature_dim, n_classes, n_labels)
        inputs = self.discriminator_inputs
        hidden = settings.hidden
        # It gives a logit of "source" (B, 1). Both domains come as one batch, whose statistics standardise its input: a
        # batch normalisation of each by itself would remove the very shift that it should see.
        self.discriminator = nn.Sequential(
            nn.BatchNorm1d(inputs, affine=False),
            nn.Linear(inputs, hidden),
            nn.ReLU(),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
            nn.Linear(hidden, 1),
        )

    @property
    def discriminator_inputs(self) -> int:
        """How many numbers per frame the discriminator sees."""
        return self.feature_dim

    def conditioned(self, features: Tensor, activations: Activations) -> Tensor:
        """Return what the discriminator sees of frames: here their features (B, D) themselves."""
        return features

    def loss(self, source: Activations, target: Activations, step: Step) -> TransferLoss:
        shown = [self.conditioned(reverse_gradient(a.features, step.weight), a) for a in (source, target)]
        logits = self.discriminator(torch.cat(shown))[:, 0]
        n = len(source.features)
        right = torch.cat([logits[:n] > 0, logits[n:] <= 0]).float().mean()
        return TransferLoss(domain_loss(logits[:n], logits[n:]), 1.0, {"discriminator_accuracy": right})


def multilinear_map(features: Tensor, condition: Tensor) -> Tensor:
    """Return the outer products (B, C·D) of features (B, D) with conditions (B, C) ([2], equation 4)."""
    return torch.einsum("nc,nd->ncd", condition, features).flatten(1)


class CDAN(DANN):
    """Regression with a domain-adversarial loss on the feature, given the predicted force."""

    @property
    def discriminator_inputs(self) -> int:
        return (1 + self.n_labels) * self.feature_dim

    def conditioned(self, features: Tensor, activations: Activations) -> Tensor:
        prediction = activations.prediction.detach()
        return multilinear_map(features, torch.cat([torch.ones_like(prediction[:, :1]), prediction], dim=1))
