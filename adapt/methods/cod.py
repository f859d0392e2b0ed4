"""COD: match mean and covariance of the features given the force, by operators between kernel spaces [1].

With the kernels K of features and G of forces, the conditional mean operator of a domain is U = Φ (G² + εI)⁻¹ G Ψᵀ and
its conditional covariance C = Φ H B H Φᵀ/n, B = nε (HGH + nεI)⁻¹, H the centring matrix. The loss is the authors'
modified form, −‖U_s + U_t‖_HS plus the squared Bures distance of the covariances, so that it may be negative. Both
kernels are sums of five Gaussians. Target forces are the network's own predictions.

Deviations from the authors' code: the marginal part, which may be any discrepancy, is MK-MMD and not DARE-GRAM; both
parts share the ramp of λ_t, where theirs adds the conditional part after a warm-up of its own; no random columns are
appended to the forces; the operators are computed in float64.

[1] Yang, Ren, Luo, "COD: learning conditional invariant representation for domain adaptation regression", ECCV 2024.
"""

import torch
from pydantic import Field
from torch import Tensor

from gelgap.adapt.methods.base import Method, MethodSettings
from gelgap.adapt.methods.dan import mmd_of_kernel, pooled_kernel
from gelgap.adapt.network import Activations

_EIGENVALUE_SHIFT = 1e-4
"""Added by the authors to the eigenvalues of B before their root is taken."""


def conditional_operator_discrepancy(
    feature_kernel: Tensor, force_s: Tensor, force_t: Tensor, ridge: float
) -> Tensor:
    """Return COD in the authors' modified form, from a pooled kernel of the features.

    Parameters
    ----------
    feature_kernel
        (n + m, n + m), source first.
    force_s, force_t
        (n, k) and (m, k) normalised labels; no gradient flows through them.
    ridge
        ε of the operators.
    """
    force_kernel = pooled_kernel(force_s.detach().double(), force_t.detach().double())
    kernel, n = feature_kernel.double(), len(force_s)
    value = mean_part(kernel, force_kernel, n, ridge) + covariance_part(kernel, force_kernel, n, ridge)
    return value.to(feature_kernel.dtype)


def mean_part(kernel: Tensor, force_kernel: Tensor, n: int, ridge: float) -> Tensor:
    """Return −‖U_s + U_t‖ of pooled kernels (n + m, n + m) of features and forces."""
    own = force_kernel[:n, :n], force_kernel[n:, n:]
    # (G² + εI)⁻¹ G of either domain.
    weights = torch.block_diag(*(torch.linalg.solve(g @ g + ridge * torch.eye(len(g)).to(g), g) for g in own))
    return -(kernel * (weights @ force_kernel @ weights)).sum().sqrt()


def covariance_part(kernel: Tensor, force_kernel: Tensor, n: int, ridge: float) -> Tensor:
    """Return tr C_s + tr C_t − 2 tr(C_s^½ C_t C_s^½)^½, the squared Bures distance of the conditional covariances.

    The centred cross kernel always has a singular value 0; it is left out, since its gradient is arbitrary.
    """
    own, roots = 0, []
    for part in (slice(n), slice(n, None)):
        k, g = kernel[part, part], force_kernel[part, part]
        size = len(g)
        centre = torch.eye(len(g)).to(g) - 1 / size
        b = ridge * size * torch.linalg.inv(centre @ g @ centre + ridge * size * torch.eye(len(g)).to(g))
        own = own + (k * (centre @ b @ centre)).sum() / size
        values, vectors = torch.linalg.eigh((b + b.T) / 2)
        roots.append(centre @ vectors * (values.clamp_min(0) + _EIGENVALUE_SHIFT).sqrt())
    cross = torch.linalg.svdvals(roots[0].T @ kernel[:n, n:] @ roots[1])[:-1].sum()
    return own - 2 * cross / (n * (len(kernel) - n)) ** 0.5


class COD(Method):
    """Regression with the conditional operator discrepancy and MK-MMD on the transfer feature."""

    class Settings(MethodSettings):
        ridge: float = Field(default=0.05, gt=0, description="regularisation of the conditional operators")
        marginal: float = Field(default=1.0, ge=0, description="weight of the marginal MK-MMD")

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        s = self.settings
        kernel = pooled_kernel(source.features, target.features)
        conditional = conditional_operator_discrepancy(kernel, source.force, target.prediction, s.ridge)
        return conditional + s.marginal * mmd_of_kernel(kernel, len(source.features))
