"""Methods without a loss of their own between the domains: what the others are compared with.

[1] Li, Wang, Shi, Liu, Hou, "Revisiting batch normalization for practical domain adaptation", ICLR workshop 2017.
"""

import torch
from torch import Tensor
from torch.nn import functional

from gelgap.adapt.methods.base import Activations, Adaptation, Method, Step, TransferLoss


class ConstantMean(Method):
    """The source's mean force for every frame: the regression head's bias gives it, its weights are zero."""

    uses_target = False
    needs_stage_1 = False

    def adapt(self, adaptation: Adaptation) -> None:
        """Set the head to the source's mean force."""
        head = adaptation.network.regressor[0]
        mean = torch.as_tensor(adaptation.source_labels.mean(axis=0), dtype=head.bias.dtype)
        with torch.no_grad():
            head.weight.zero_()
            head.bias.copy_(torch.logit(mean))


class SourceOnly(Method):
    """The network of stage 1 as it is, without adaptation (the paper's "source-only"); it sees no target picture."""

    uses_target = False

    def adapt(self, adaptation: Adaptation) -> None:
        """Leave the network as stage 1 left it."""


class AdaBN(Method):
    """The target's batch-normalisation statistics, the same weights [1].

    Enough where the gap is a change of the features' means and scales.
    """

    def adapt(self, adaptation: Adaptation) -> None:
        """Re-estimate the statistics on the unlabelled target pictures."""
        adaptation.estimate_target_statistics()


class NoTransfer(Method):
    """Stage 2 without a transfer loss: as long a training, under the same batch statistics, as the methods have."""

    compares_features = False

    def transfer_loss(self, source: Activations, target: Activations | None) -> Tensor:
        return source.features.new_zeros(())


class ClassifierOnly(NoTransfer):
    """Regression and contact classification on the source: all that DSAN trains, without its loss."""

    uses_classifier = True


class Supervised(Method):
    """Regression on the labels of both domains, at full weight from the first step: an upper limit, not a method.

    It starts from the same stage-1 network and has the same budget as the methods it bounds.
    """

    uses_target_labels = True

    def loss(self, source: Activations, target: Activations, step: Step) -> TransferLoss:
        return TransferLoss(functional.mse_loss(target.prediction, target.force), weight=1.0)
