"""UGA: evidential regression guides the alignment of features and of mixed features [1].

A head beside the regression predicts how certain each force is, by the parameters (ν, α, β) of a normal-inverse-gamma
distribution [2]. The transfer loss is the MK-MMD between source and target features, and between source features and
target features that are mixed with features of similar force (C-Mixup). As in the authors' code, its alignment
"feature".

Differences: the evidential loss is added to the squared error instead of replacing it, with a weight of its own,
since its gradient is some thousand times larger than that of a force that is nearly right; the batch normalisations
learn, and there is no dropout, as in every other method here.

[1] Nejjar, Frusque, Forest, Fink, "Uncertainty-guided alignment for unsupervised domain adaptation in regression",
    Reliability Engineering and System Safety 270, 2026.
[2] Amini, Schwarting, Soleimany, Rus, "Deep evidential regression", NeurIPS 2020.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from pydantic import Field
from torch import Tensor, nn
from torch.nn import functional

from gelgap.adapt.methods.base import Activations, Method, MethodSettings, Step, TransferLoss
from gelgap.adapt.methods.mmd import mk_mmd

_LEAST = 1e-5


class Evidence(NamedTuple):
    """Parameters (B, k) of the normal-inverse-gamma distribution of each label: ν > 0, α > 1, β > 0."""

    nu: Tensor
    alpha: Tensor
    beta: Tensor


def evidential_loss(force: Tensor, prediction: Tensor, evidence: Evidence) -> Tensor:
    """Return the mean negative log-likelihood of labels (B, k), regularised by |error|·(2ν + α) ([2], section 3).

    No gradient flows through the regulariser's error: it takes evidence away where the force is wrong.
    """
    nu, alpha, beta = evidence
    omega = 2 * beta * (1 + nu)
    likelihood = (
        0.5 * torch.log(math.pi / nu)
        - alpha * torch.log(omega + _LEAST)
        + (alpha + 0.5) * torch.log(nu * (force - prediction).square() + omega + _LEAST)
        + torch.lgamma(alpha)
        - torch.lgamma(alpha + 0.5)
    )
    error = (force - prediction).detach().abs()
    return likelihood.mean() + (error * (2 * nu + alpha)).mean()


def similar(queries: Tensor, pool: Tensor, width: float, uniform: Tensor) -> Tensor:
    """Return for each row of `queries` (B, k) the index of a near one of `pool` (P, k), drawn by a Gaussian.

    uniform (B,) in [0, 1) decides the draw.
    """
    weights = torch.softmax(-torch.cdist(queries, pool).square() / (2 * width**2), dim=1)
    return torch.searchsorted(weights.cumsum(dim=1), uniform[:, None]).clamp(max=len(pool) - 1)[:, 0]


class UGA(Method):
    """Evidential regression with MK-MMD on features and on features mixed across domains."""

    class Settings(MethodSettings):
        evidential_weight: float = Field(
            default=0.001, ge=0, description="weight of the evidential loss; published: 1"
        )
        mixing_width: float = Field(
            default=0.2, gt=0, description="width of C-Mixup's Gaussian on normalised forces"
        )

    settings: Settings

    def __init__(self, settings: Settings, feature_dim: int, n_classes: int, n_labels: int = 3) -> None:
        super().__init__(settings, feature_dim, n_classes, n_labels)
        self.evidence_head = nn.Linear(feature_dim, 3 * n_labels)
        nn.init.zeros_(self.evidence_head.bias)

    def evidence(self, features: Tensor) -> Evidence:
        """Return the evidence for the forces of features (B, D)."""
        positive = functional.softplus(self.evidence_head(features)).unflatten(1, (-1, 3))
        nu, alpha, beta = positive.unbind(dim=2)
        return Evidence(nu + _LEAST, alpha + 1 + _LEAST, beta + _LEAST)

    def loss(self, source: Activations, target: Activations, step: Step) -> TransferLoss:
        evidence = self.evidence(source.features)
        value = self.settings.evidential_weight * evidential_loss(source.force, source.prediction, evidence)
        if step.weight > 0:
            mixed = self._mixed(source, target, step.rng)
            alignment = mk_mmd(source.features, target.features) + mk_mmd(source.features, mixed)
            value = value + step.weight * alignment
        variance = (evidence.beta / (evidence.nu * (evidence.alpha - 1))).detach()
        return TransferLoss(value, 1.0, {"epistemic_variance": variance.median()})

    def _mixed(self, source: Activations, target: Activations, rng: np.random.Generator) -> Tensor:
        """Return target features, each mixed with one of either domain whose (predicted) force is similar."""
        forces = torch.cat([target.prediction.detach(), source.force])
        uniform = torch.from_numpy(rng.random(len(target.features))).to(forces)
        partner = similar(target.prediction.detach(), forces, self.settings.mixing_width, uniform)
        share = float(rng.beta(2, 2))
        return share * target.features + (1 - share) * torch.cat([target.features, source.features])[partner]
