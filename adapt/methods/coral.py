"""Deep CORAL: match the covariances of the features [1].

tllib's loss is four times this one, plus the mean squared distance of the features' means.

[1] Sun, Saenko, "Deep CORAL: correlation alignment for deep domain adaptation", ECCV workshops 2016.
"""

from torch import Tensor

from gelgap.adapt.methods.base import Method
from gelgap.adapt.network import Activations


def coral(source: Tensor, target: Tensor) -> Tensor:
    """Return ‖C_s − C_t‖²_F / (4 D²) of features (n, D), with unbiased covariances ([1], equation 1).

    Blind to a shift of the mean. Computed in float64: a common offset of 1e4 would cost float32 its digits.

    Raises
    ------
    ValueError
        If a batch has one frame, which has no covariance.
    """
    if min(len(source), len(target)) < 2:
        raise ValueError(f"CORAL needs at least 2 frames per domain, not {len(source)} and {len(target)}")
    difference = _covariance(source) - _covariance(target)
    return (difference.square().sum() / (4 * source.shape[1] ** 2)).to(source.dtype)


def _covariance(features: Tensor) -> Tensor:
    centred = features.double()
    centred = centred - centred.mean(dim=0)
    return centred.T @ centred / (len(features) - 1)


class DeepCORAL(Method):
    """Regression with CORAL on the transfer feature."""

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        return coral(source.features, target.features)
