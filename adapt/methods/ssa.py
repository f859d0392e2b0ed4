"""SSA: source-free adaptation by aligning the features' significant subspace at test time [1].

Of the source only the features' mean and leading principal directions are used. The scales and offsets of the batch
normalisations are trained on unlabelled target pictures so that the target's features, projected on these directions,
have the source's mean and variance.

Deviations of `ssa` from the authors' code: K is 20, not 100; three passes over the target, not one that
predicts each batch as it comes; the weight α of a direction sums over the outputs; at the end the running
statistics are estimated anew on the target.

`online-ssa` is the authors' form: every picture is seen once, the statistics of the batch normalisations follow the
stream, scales and offsets take a step a batch, and nothing is estimated anew at the end.

`psc` [2] also draws the variance of the orthogonal complement, which SSA leaves to itself, to the source's, as one
block. It is written from the abstract, with SSA's divergence of one isotropic Gaussian a domain. No public code was
found.

[1] Adachi, Yamaguchi, Kumagai, Hamagami, "Test-time adaptation for regression by subspace alignment", ICLR 2025.
[2] Nguyen, Huynh, Pham, "Predictive spectral calibration for source-free test-time regression", arXiv:2603.09338, 2026.
"""

from typing import NamedTuple

import torch
from pydantic import Field
from torch import Tensor, nn

from gelgap.adapt.methods.base import Adaptation, Method, MethodSettings, descend


class Subspace(NamedTuple):
    """What is kept of the source's features: their mean (D,) and K orthonormal principal directions (D, K).

    `variances` (K,) are along these, `weights` (K,) the α of `subspace_loss`, and `slack` the mean squared distance of
    the features from the subspace.
    """

    mean: Tensor
    directions: Tensor
    variances: Tensor
    weights: Tensor
    slack: Tensor


def subspace_loss(features: Tensor, subspace: Subspace) -> Tensor:
    """Return Σ_d α_d (KL(target‖source) + KL(source‖target)) of target features (B, D) [1].

    Each domain has one Gaussian per direction.
    """
    projected = (features.double() - subspace.mean) @ subspace.directions
    shift = projected.mean(dim=0).square()
    variance = projected.var(dim=0) + 1e-6 * subspace.variances
    both = (shift + subspace.variances) / variance + (shift + variance) / subspace.variances - 2
    return (subspace.weights * both / 2).sum().to(features.dtype)


def slack_loss(features: Tensor, subspace: Subspace) -> Tensor:
    """Return KL(target‖source) + KL(source‖target) of the features (B, D) beside the subspace, over its dimensions.

    With r the target's mean squared distance from the subspace over the source's it is (r + 1/r − 2)/2.
    """
    centred = features.double() - subspace.mean
    left = centred - centred @ subspace.directions @ subspace.directions.T
    ratio = (left.square().sum(dim=1).mean() / subspace.slack.clamp_min(1e-12)).clamp_min(1e-6)
    return ((ratio + 1 / ratio - 2) / 2).to(features.dtype)


class SSA(Method):
    """Test-time adaptation by significant-subspace alignment."""

    class Settings(MethodSettings):
        directions: int = Field(
            default=20, ge=1, description="principal directions of the source's features to align"
        )
        epochs: int = Field(default=3, ge=1, description="passes over the target")
        learning_rate: float = Field(default=1e-3, ge=0, description="Adam's learning rate")

    grid = ("learning_rate", (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1))

    def adapt(self, adaptation: Adaptation) -> None:
        """Take the source's feature statistics, then train the normalisations on target pictures alone."""
        self.follow(adaptation, self.settings.epochs)
        adaptation.estimate_target_statistics()

    def alignment(self, features: Tensor, subspace: Subspace) -> Tensor:
        """Return the loss of a batch of target features (B, D)."""
        return subspace_loss(features, subspace)

    def follow(self, adaptation: Adaptation, passes: int) -> None:
        """Train the normalisations' scales and offsets in passes over the target's pictures."""
        network, subspace = adaptation.network, self._subspace(adaptation)
        norms = (module for module in network.modules() if isinstance(module, nn.BatchNorm2d))
        parameters = [p for norm in norms for p in norm.parameters()]
        optimizer = torch.optim.Adam(parameters, lr=self.settings.learning_rate)
        network.train()
        for epoch in range(passes):
            for batch in adaptation.target_batches(epoch):
                descend(optimizer, self.alignment(network.features(batch), subspace), "SSA")

    @torch.no_grad()
    def _subspace(self, adaptation: Adaptation) -> Subspace:
        network = adaptation.network
        features = torch.cat([network.features(batch) for batch in adaptation.source_batches(0)]).double()
        mean = features.mean(dim=0)
        values, vectors = torch.linalg.eigh((features - mean).T @ (features - mean) / (len(features) - 1))
        count = int(min(self.settings.directions, (values > 1e-8 * values[-1]).sum()))
        variances, directions = values.flip(0)[:count], vectors.flip(1)[:, :count]
        head = network.regressor[0].weight.double()
        slack = values.clamp_min(0).sum() - variances.sum()
        return Subspace(mean, directions, variances, 1 + (head @ directions).abs().sum(dim=0), slack)


class OnlineSSA(SSA):
    """Test-time adaptation in a single pass over the target's pictures as they come."""

    class Settings(MethodSettings):
        directions: int = Field(
            default=100, ge=1, description="principal directions of the source's features"
        )
        learning_rate: float = Field(default=1e-3, ge=0, description="Adam's learning rate")

    def adapt(self, adaptation: Adaptation) -> None:
        """Take the source's feature statistics, then follow the target's pictures."""
        self.follow(adaptation, passes=1)


class PSC(SSA):
    """SSA, and the variance beside its subspace."""

    class Settings(SSA.Settings):
        slack_weight: float = Field(default=1.0, ge=0, description="weight of what lies beside the subspace")

    def alignment(self, features: Tensor, subspace: Subspace) -> Tensor:
        aligned = subspace_loss(features, subspace)
        return aligned + self.settings.slack_weight * slack_loss(features, subspace)
