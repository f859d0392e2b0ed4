"""Mean teacher: the target's predictions agree with those of a slowly moving average of the network [1, 2].

The network sees the target's pictures with their colours mixed at random, the teacher sees them as they are; the
teacher's forces are the pseudo-labels. [2] augments both sides and keeps confident pseudo-labels only; a regression
has no class probability to be confident by, and the ramp of λ_t takes that part.

[1] Tarvainen, Valpola, "Mean teachers are better role models", NIPS 2017.
[2] French, Mackiewicz, Fisher, "Self-ensembling for visual domain adaptation", ICLR 2018.
"""

import copy

import torch
from pydantic import Field
from torch import Tensor
from torch.nn import functional

from gelgap.adapt.data import mix_colours
from gelgap.adapt.methods.base import Method, MethodSettings, Step, TransferLoss
from gelgap.adapt.model import move_towards
from gelgap.adapt.network import Activations, ForceNetwork


class MeanTeacher(Method):
    """Regression, and agreement with the teacher on the target; the result is the teacher."""

    class Settings(MethodSettings):
        decay: float = Field(
            default=0.99, ge=0, lt=1, description="share of the teacher's weights that a step keeps"
        )

    def begin(self, network: ForceNetwork) -> None:
        """Let the teacher start as the network that stage 1 trained."""
        self.teacher = copy.deepcopy(network).requires_grad_(False).train()

    def augment(self, inputs: Tensor, step: Step) -> Tensor:
        return mix_colours(inputs, 1.0, step.rng)

    def loss(self, source: Activations, target: Activations, step: Step) -> TransferLoss | None:
        if step.weight == 0:
            return None
        with torch.no_grad():
            pseudo_label = self.teacher(target.inputs).float()
        error = functional.mse_loss(target.prediction, pseudo_label)
        return TransferLoss(error, step.weight, {"teacher_spread": pseudo_label.std(dim=0).mean()})

    def after_step(self, network: ForceNetwork) -> None:
        """Move the teacher's weights towards the network's ([1], equation 1)."""
        move_towards(self.teacher, network, 1 - self.settings.decay, buffers=False)

    def finish(self, network: ForceNetwork) -> None:
        network.load_state_dict(self.teacher.state_dict())
