"""Online test-time adaptation: SSA as published, one pass over the target's pictures as they come [1].

Every picture is seen once: the statistics of the batch normalisations follow the stream, scales and offsets take a step
a batch, and nothing is estimated anew at the end.

[1] Adachi, Yamaguchi, Kumagai, Hamagami, "Test-time adaptation for regression by subspace alignment", ICLR 2025.
"""

from pydantic import Field

from gelgap.adapt.methods.base import Adaptation, MethodSettings
from gelgap.adapt.methods.ssa import SSA


class OnlineSSA(SSA):
    """Test-time adaptation in a single pass."""

    class Settings(MethodSettings):
        directions: int = Field(
            default=100, ge=1, description="principal directions of the source's features"
        )
        learning_rate: float = Field(default=1e-3, ge=0, description="Adam's learning rate")

    def adapt(self, adaptation: Adaptation) -> None:
        """Take the source's feature statistics, then follow the target's pictures."""
        self.follow(adaptation, passes=1)
