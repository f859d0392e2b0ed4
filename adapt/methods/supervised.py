"""Supervised on the target: train on its labels too. An upper limit, not a method for domain adaptation."""

from torch import Tensor
from torch.nn import functional

from gelgap.adapt.methods.base import Method
from gelgap.adapt.network import Activations


class Supervised(Method):
    """Regression on the labels of both domains, at full weight and without ramp.

    It starts from the same stage-1 network and has the same budget as the methods it bounds.
    """

    uses_target_labels = True
    scheduled = False

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        return functional.mse_loss(target.prediction, target.force)
