"""DeepJDOT: align source and target frames that the optimal transport of features and labels pairs [1, 2].

In every step an exact plan γ between the batches is found for the cost α‖f_s − f_t‖² + ‖y_s − ŷ_t‖² of features and
labels; the loss is that cost under γ. For batches of one size some assignment is a best plan (Birkhoff, von Neumann).

Deviations from the authors' code: labels are forces, so their loss is the squared distance of [2] and not a
cross-entropy; features cost their mean, not their sum over the dimensions.

[1] Damodaran, Kellenberger, Flamary, Tuia, Courty, "DeepJDOT: deep joint distribution optimal transport for
    unsupervised domain adaptation", ECCV 2018.
[2] Courty, Flamary, Habrard, Rakotomamonjy, "Joint distribution optimal transportation for domain adaptation",
    NeurIPS 2017.
"""

import numpy as np
import torch
from pydantic import Field
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from gelgap.adapt.methods.base import Method, MethodSettings
from gelgap.adapt.network import Activations


def transport_plan(cost: np.ndarray) -> np.ndarray:
    """Return the plan (n, m) of least cost (n, m) between equal masses 1/n and 1/m."""
    n, m = cost.shape
    size = np.lcm(n, m)
    rows, columns = linear_sum_assignment(cost.repeat(size // n, axis=0).repeat(size // m, axis=1))
    plan = np.zeros((n, m))
    np.add.at(plan, (rows // (size // n), columns // (size // m)), 1 / size)
    return plan


def joint_transport(
    source: Tensor, target: Tensor, force: Tensor, prediction: Tensor, alpha: float
) -> Tensor:
    """Return Σ γ (α‖f_s − f_t‖² + ‖y_s − ŷ_t‖²) of features (n, D), (m, D), labels (n, k) and predictions (m, k)."""
    cost = alpha * _squared(source, target) + _squared(force, prediction)
    plan = transport_plan(cost.detach().double().cpu().numpy())
    return (torch.from_numpy(plan).to(cost) * cost).sum()


def _squared(one: Tensor, other: Tensor) -> Tensor:
    return (one[:, None] - other[None]).square().sum(dim=2)


class DeepJDOT(Method):
    """Regression with the cost of the joint transport of features and labels."""

    class Settings(MethodSettings):
        alpha: float = Field(
            default=1.0, ge=0, description="weight of the features' mean squared distance beside the labels'"
        )

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        alpha = self.settings.alpha / source.features.shape[1]
        return joint_transport(source.features, target.features, source.force, target.prediction, alpha)
