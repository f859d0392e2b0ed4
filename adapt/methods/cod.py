"""Match the features given the force: mean and covariance by operators between kernel spaces (COD), or means alone.

COD [1]: with the kernels K of features and G of forces, the conditional mean operator of a domain is U = Φ (G² + εI)⁻¹
G Ψᵀ and its conditional covariance C = Φ H B H Φᵀ/n, B = nε (HGH + nεI)⁻¹, H the centring matrix. The loss is the
authors' modified form, −‖U_s + U_t‖_HS plus the squared Bures distance of the covariances, so that it may be negative.
Both kernels are sums of five Gaussians. Target forces are the network's own predictions.

Deviations from its authors' code: the marginal part, which may be any discrepancy, is MK-MMD and not DARE-GRAM; both
parts share the ramp of λ_t, where theirs adds the conditional part after a warm-up of its own; no random columns are
appended to the forces; the operators are computed in float64.

Conditional MMD [2]: the conditional mean embedding of a domain maps a force y to μ(y) = Σ_i β_i(y) φ(f_i), β(y) = (K_y
+ nεI)⁻¹ k_y(y). The discrepancy is the squared distance between the two domains' embeddings, averaged over the forces
of both batches: the first moment alone of what COD matches, and never negative. MK-MMD is added as the marginal part.

[1] Yang, Ren, Luo, "COD: learning conditional invariant representation for domain adaptation regression", ECCV 2024.
[2] Song, Huang, Smola, Fukumizu, "Hilbert space embeddings of conditional distributions with applications to dynamical
    systems", ICML 2009.
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

    def conditional(self, kernel: Tensor, force_s: Tensor, force_t: Tensor) -> Tensor:
        """Return the discrepancy of features with a pooled kernel, given their forces."""
        return conditional_operator_discrepancy(kernel, force_s, force_t, self.settings.ridge)

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        kernel = pooled_kernel(source.features, target.features)
        conditional = self.conditional(kernel, source.force, target.prediction)
        return conditional + self.settings.marginal * mmd_of_kernel(kernel, len(source.features))


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


class ConditionalMMD(COD):
    """Regression with the conditional MMD and MK-MMD on the transfer feature."""

    class Settings(COD.Settings):
        force_width: float = Field(default=0.1, gt=0, description="width of the kernel on normalised forces")
        ridge: float = Field(default=0.01, gt=0, description="regularisation of the conditional embeddings")

    def conditional(self, kernel: Tensor, force_s: Tensor, force_t: Tensor) -> Tensor:
        return conditional_mmd(kernel, force_s, force_t, self.settings.force_width, self.settings.ridge)
