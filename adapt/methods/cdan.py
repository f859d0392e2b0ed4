"""CDAN: a domain discriminator on features that are conditioned on the prediction [1].

The published discriminator sees the outer product of feature and class probabilities. Forces have no classes: here it
is the outer product of the feature with (1, F̂), F̂ the normalised force (or other labels) without gradient, so that
it sees the feature itself and how it goes with each axis. Entropy conditioning (CDAN+E) needs probabilities and is left
out.

[1] Long, Cao, Wang, Jordan, "Conditional adversarial domain adaptation", NeurIPS 2018.
"""

import torch
from torch import Tensor

from gelgap.adapt.methods.dann import DANN
from gelgap.adapt.network import Activations


def multilinear_map(features: Tensor, condition: Tensor) -> Tensor:
    """Return the outer products (B, C·D) of features (B, D) with conditions (B, C) ([1], equation 4)."""
    return torch.einsum("nc,nd->ncd", condition, features).flatten(1)


class CDAN(DANN):
    """Regression with a domain-adversarial loss on the feature, given the predicted force."""

    @property
    def discriminator_inputs(self) -> int:
        return (1 + self.n_labels) * self.feature_dim

    def conditioned(self, features: Tensor, activations: Activations) -> Tensor:
        prediction = activations.prediction.detach()
        return multilinear_map(features, torch.cat([torch.ones_like(prediction[:, :1]), prediction], dim=1))
