"""Source-only: the stage-1 network as it is. It never sees a target picture."""

from gelgap.adapt.methods.base import Adaptation, Method


class SourceOnly(Method):
    """The baseline without adaptation (the paper's "source-only")."""

    uses_target = False

    def adapt(self, adaptation: Adaptation) -> None:
        """Leave the network as stage 1 left it."""
