"""Conditional MMD: match the features' mean given the force, by conditional mean embeddings [1].

The conditional mean embedding of a domain maps a force y to μ(y) = Σ_i β_i(y) φ(f_i), β(y) = (K_y + nεI)⁻¹ k_y(y). The
discrepancy is the squared distance between the two domains' embeddings, averaged over the forces of both batches: the
first moment alone of what `cod` matches, and never negative. Target forces are the network's own predictions. MK-MMD is
added as the marginal part.

[1] Song, Huang, Smola, Fukumizu, "Hilbert space embeddings of conditional distributions with applications to dynamical
    systems", ICML 2009.
"""

import torch
from pydantic import Field
from torch import Tensor

from gelgap.adapt.methods.base import Method, MethodSettings
from gelgap.adapt.methods.dan import mmd_of_kernel, pooled_kernel
from gelgap.adapt.network import Activations


def conditional_mmd(
    feature_kernel: Tensor, force_s: Tensor, force_t: Tensor, width: float, ridge: float
) -> Tensor:
    """Return mean_y ‖μ_s(y) − μ_t(y)‖² over the forces y of both batches.

    Parameters
    ----------
    feature_kernel
        (n + m, n + m) kernel of the pooled features, source first.
    force_s, force_t
        (n, 3) and (m, 3) normalised forces; no gradient flows through them.
    width
        Width of the Gaussian kernel on forces.
    ridge
        ε of the embeddings.
    """
    force_s, force_t = force_s.detach().double(), force_t.detach().double()
    where = torch.cat([force_s, force_t])

    def weights(force: Tensor) -> Tensor:
        shift = ridge * len(force) * torch.eye(len(force), dtype=force.dtype, device=force.device)
        return torch.linalg.solve(_gaussian(force, force, width) + shift, _gaussian(force, where, width))

    difference = torch.cat([weights(force_s), -weights(force_t)])
    kernel = feature_kernel.double()
    value = (difference * (kernel @ difference)).sum() / len(where)
    return value.to(feature_kernel.dtype)


def _gaussian(x: Tensor, y: Tensor, width: float) -> Tensor:
    squares = (x[:, None, :] - y[None, :, :]).square().sum(dim=2)
    return torch.exp(-squares / (2 * width**2))


class ConditionalMMD(Method):
    """Regression with the conditional MMD and MK-MMD on the transfer feature."""

    class Settings(MethodSettings):
        force_width: float = Field(default=0.1, gt=0, description="width of the kernel on normalised forces")
        ridge: float = Field(default=0.01, gt=0, description="regularisation of the conditional embeddings")
        marginal: float = Field(default=1.0, ge=0, description="weight of the marginal MK-MMD")

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        s = self.settings
        kernel = pooled_kernel(source.features, target.features)
        conditional = conditional_mmd(kernel, source.force, target.prediction, s.force_width, s.ridge)
        return conditional + s.marginal * mmd_of_kernel(kernel, len(source.features))
