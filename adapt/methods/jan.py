"""JAN: match the joint distribution of feature and prediction by the joint MMD [1].

Deviations from public code (tllib): those of MK-MMD, and five kernels on the prediction, whose bandwidth follows its
distances, where tllib has one of σ = 0.92, chosen for class probabilities.

[1] Long, Zhu, Wang, Jordan, "Deep transfer learning with joint adaptation networks", ICML 2017.
"""

import math
from collections.abc import Sequence

from torch import Tensor

from gelgap.adapt.methods.base import Method
from gelgap.adapt.methods.dan import RobustSettings, mmd_of_kernel, pooled_kernel
from gelgap.adapt.network import Activations


def joint_mmd(source: Sequence[Tensor], target: Sequence[Tensor], robust: bool = False) -> Tensor:
    """Return the squared MMD with the product over layers of multi-Gaussian kernels ([1], equation 9).

    source and target hold the activations (n, D_l) and (m, D_l) of the same layers. With one layer this is
    MK-MMD.
    """
    kernels = (pooled_kernel(*layer, robust) for layer in zip(source, target, strict=True))
    return mmd_of_kernel(math.prod(kernels), len(source[0]))


class JAN(Method):
    """Regression with joint MMD over the transfer feature and the predicted force."""

    Settings = RobustSettings

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        layers_s, layers_t = ((a.features, a.prediction) for a in (source, target))
        return joint_mmd(layers_s, layers_t, self.settings.robust)
