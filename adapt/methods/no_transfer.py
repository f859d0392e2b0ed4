"""No transfer: stage 2 without a transfer loss, the control that isolates the effect of a method's loss."""

from torch import Tensor

from gelgap.adapt.methods.base import Method
from gelgap.adapt.network import Activations


class NoTransfer(Method):
    """Regression on the source for as long as the methods train, under the same batch statistics."""

    def transfer_loss(self, source: Activations, target: Activations) -> Tensor:
        return source.features.new_zeros(())
