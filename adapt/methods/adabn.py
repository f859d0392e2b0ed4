"""AdaBN: replace the batch-normalisation statistics of the source by those of the target [1].

[1] Li, Wang, Shi, Liu, Hou, "Revisiting batch normalization for practical domain adaptation", ICLR workshop 2017.
"""

from gelgap.adapt.methods.base import Adaptation, Method


class AdaBN(Method):
    """New batch statistics, the same weights: enough where the gap is a change of feature means and scales."""

    def adapt(self, adaptation: Adaptation) -> None:
        """Re-estimate the statistics on the unlabelled target pictures."""
        adaptation.estimate_target_statistics()
