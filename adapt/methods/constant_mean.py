"""Constant mean: predict the source's mean force for every frame, the baseline that a method must beat."""

import torch

from gelgap.adapt.methods.base import Adaptation, Method


class ConstantMean(Method):
    """The regression head with zero weights: its bias gives the mean, whatever the picture."""

    uses_target = False
    needs_stage_1 = False

    def adapt(self, adaptation: Adaptation) -> None:
        """Set the head to the source's mean force."""
        mean = adaptation.source_mean()
        head = adaptation.network.regressor[0]
        with torch.no_grad():
            head.weight.zero_()
            head.bias.copy_(torch.logit(torch.as_tensor(mean, dtype=head.bias.dtype)))
