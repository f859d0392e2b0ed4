"""Importance weighting: source frames that look like target frames count more in the regression [1].

A discriminator on the features tells the domains apart; its odds are the ratio of the target's to the source's
density [2]. It learns along and moves no feature, so that nothing is aligned: the method corrects another frequency
of contacts, not another look of them.

[1] Shimodaira, "Improving predictive inference under covariate shift by weighting the log-likelihood function", Journal
    of Statistical Planning and Inference 90, 2000.
[2] Bickel, Brückner, Scheffer, "Discriminative learning under covariate shift", JMLR 10, 2009.
"""

import torch
from pydantic import Field
from torch import Tensor

from gelgap.adapt.methods.base import Step, TransferLoss
from gelgap.adapt.methods.dann import DANN, domain_loss
from gelgap.adapt.network import Activations


def density_ratio(logits: Tensor, largest: float) -> Tensor:
    """Return p_target/p_source (B,) at source frames from a discriminator's logits of "source".

    Its mean over the batch is 1. Ratios above `largest` are cut: a few frames would else carry the whole regression.
    """
    ratio = torch.exp(-logits.detach()).clamp(max=largest)
    return ratio / ratio.mean().clamp_min(torch.finfo(ratio.dtype).tiny)


class ImportanceWeighting(DANN):
    """Regression on the source with weights 1 + λ_t(w − 1): λ_t = 1 is the weighted risk, 0 the plain one."""

    class Settings(DANN.Settings):
        largest_ratio: float = Field(default=10.0, gt=1, description="density ratios are cut here")

    grid = ("transfer_weight", (0.0, 0.01, 0.03, 0.1, 0.3, 0.6, 1.0))

    def loss(self, source: Activations, target: Activations, step: Step) -> TransferLoss:
        n = len(source.features)
        logits = self.discriminator(torch.cat([source.features, target.features]).detach())[:, 0]
        ratio = density_ratio(logits[:n], self.settings.largest_ratio)
        error = (source.prediction - source.force).square().mean(dim=1)
        value = domain_loss(logits[:n], logits[n:]) + step.weight * ((ratio - 1) * error).mean()
        return TransferLoss(value, 1.0, {"effective_share": 1 / ratio.square().mean()})
