"""RSD: align the subspaces that the two batches of features span [1].

Deviations from the authors' code: Σ sin²θ of regularised projectors for Σ sin θ of singular vectors (see
`projection_distance`), and no penalty on the mismatch of the bases, which depends on the signs that the SVD happens to
return.

[1] Chen, Wang, Wang, Long, "Representation subspace distance for domain adaptation regression", ICML 2021.
"""

import torch
from pydantic import Field
from torch import Tensor

from gelgap.adapt.methods.base import Activations, Method, MethodSettings


def projection_distance(source: Tensor, target: Tensor, ridge: float = 1e-3) -> Tensor:
    """Return ½‖P_s − P_t‖²_F, P = Fᵀ(FFᵀ + εI)⁻¹F the regularised projector on the rows of F (B, D).

    Without ridge and with equal ranks this is Σ sin²θ over the principal angles: another loss than the published
    Σ sin θ, with the same zero, and with a finite gradient everywhere; [1] differentiates two SVDs, which gives NaN for
    equal features and repeated singular values. ε is `ridge` times the mean eigenvalue of FFᵀ, so that scaling the
    features changes nothing. No D×D matrix is formed.

    Raises
    ------
    ValueError
        If a batch has as many frames as features: it would span all of the space and the loss would be 0.
    """
    n = max(len(source), len(target))
    if n >= source.shape[1]:
        raise ValueError(
            f"RSD compares subspaces: a batch of {n} frames spans all {source.shape[1]} feature dimensions; use a "
            f"batch_size below feature_dim"
        )
    half_s, half_t = _half_projector(source.double(), ridge), _half_projector(target.double(), ridge)
    own = (half_s @ half_s.T).square().sum() + (half_t @ half_t.T).square().sum()
    return (0.5 * own - (half_s @ half_t.T).square().sum()).to(source.dtype)


def _half_projector(features: Tensor, ridge: float) -> Tensor:
    """Return H (B, D) with HᵀH = Fᵀ(FFᵀ + εI)⁻¹F, by a Cholesky factor of the B×B Gram matrix."""
    n = len(features)
    scale = features.detach().square().mean().sqrt()
    features = features / torch.where(scale > 0, scale, 1.0)
    gram = features @ features.T
    epsilon = ridge * gram.diagonal().mean() + torch.finfo(features.dtype).eps
    factor = torch.linalg.cholesky(gram + epsilon * torch.eye(n, dtype=gram.dtype, device=gram.device))
    return torch.linalg.solve_triangular(factor, features, upper=False)


class RSD(Method):
    """Regression with the subspace distance in its stable form."""

    class Settings(MethodSettings):
        ridge: float = Field(
            default=1e-3, gt=0, description="regularisation over the Gram matrix's mean eigenvalue"
        )

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        return projection_distance(source.features, target.features, self.settings.ridge)
