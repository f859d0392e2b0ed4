"""PSC: source-free adaptation that aligns the subspace predictions need, and calibrates what is left beside it [1].

SSA aligns the target's features along the source's principal directions and leaves the others to themselves. Here the
orthogonal complement's variance is drawn to the source's as well, as one block.

Written from the abstract, with SSA's divergence of one isotropic Gaussian a domain. No public code was found.

[1] Nguyen, Huynh, Pham, "Predictive spectral calibration for source-free test-time regression", arXiv:2603.09338, 2026.
"""

from pydantic import Field
from torch import Tensor

from gelgap.adapt.methods.ssa import SSA, Subspace, subspace_loss


def slack_loss(features: Tensor, subspace: Subspace) -> Tensor:
    """Return KL(target‖source) + KL(source‖target) of the features (B, D) beside the subspace, over its dimensions.

    With r the target's mean squared distance from the subspace over the source's it is (r + 1/r − 2)/2.
    """
    centred = features.double() - subspace.mean
    left = centred - centred @ subspace.directions @ subspace.directions.T
    ratio = (left.square().sum(dim=1).mean() / subspace.slack.clamp_min(1e-12)).clamp_min(1e-6)
    return ((ratio + 1 / ratio - 2) / 2).to(features.dtype)


class PSC(SSA):
    """SSA, and the variance beside its subspace."""

    class Settings(SSA.Settings):
        slack_weight: float = Field(default=1.0, ge=0, description="weight of what lies beside the subspace")

    def alignment(self, features: Tensor, subspace: Subspace) -> Tensor:
        aligned = subspace_loss(features, *subspace[:4])
        return aligned + self.settings.slack_weight * slack_loss(features, subspace)
