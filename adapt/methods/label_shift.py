"""Label shift: source frames weigh more whose force is more frequent in the target, by black-box shift estimation [1].

Forces are put into bins that each hold as many source frames. With C_ij the share of source frames of bin j that the
network of stage 1 predicts in bin i, and μ_i the share of target frames predicted there, the target's share of bin j
over the source's is w_j in C w = μ. It is solved with w ≥ 0 and drawn to 1, as in [2]. Target frames are predicted
under their own normalisation statistics: that forces look the same in both domains is the method's assumption.

[1] Lipton, Wang, Smola, "Detecting and correcting for label shift with black box predictors", ICML 2018.
[2] Azizzadenesheli, Liu, Yang, Anandkumar, "Regularized learning for domain adaptation under label shifts", ICLR 2019.
"""

import copy

import numpy as np
import torch
from pydantic import Field
from scipy.optimize import nnls

from gelgap.adapt.methods.base import Adaptation, Method, MethodSettings, Step, TransferLoss
from gelgap.adapt.network import Activations


def shift_weights(
    true_bin: np.ndarray, predicted_bin: np.ndarray, target_bin: np.ndarray, bins: int, pull: float
):
    """Return w (bins,), the target's share of each bin over the source's; `pull` says how strongly it is drawn to 1.

    true_bin and predicted_bin (n,) are of source frames, target_bin (m,) is what target frames are predicted in.
    """
    joint = np.zeros((bins, bins))
    np.add.at(joint, (predicted_bin, true_bin), 1 / len(true_bin))
    share = np.bincount(target_bin, minlength=bins) / len(target_bin)
    matrix = np.concatenate([joint, pull / bins * np.eye(bins)])
    return nnls(matrix, np.concatenate([share, np.full(bins, pull / bins)]))[0]


class LabelShift(Method):
    """Regression on the source with weights 1 + λ_t(w − 1), by bins of the last label (Fz)."""

    class Settings(MethodSettings):
        bins: int = Field(default=10, ge=2, le=100, description="bins of the last label")
        pull: float = Field(default=0.1, gt=0, description="how strongly weights are drawn to 1")

    grid = ("transfer_weight", (0.0, 0.03, 0.1, 0.2, 0.4, 0.7, 1.0))

    def adapt(self, adaptation: Adaptation) -> None:
        """Find the weights by the network of stage 1, then train stage 2 with them."""
        adapted = copy.copy(adaptation)
        adapted.network = copy.deepcopy(adaptation.network).eval()
        of_source = [(adapted.network(x)[:, -1], y[:, -1]) for x, y in adaptation.labelled_source_batches(0)]
        predicted, true = (torch.cat(parts).detach().cpu().numpy() for parts in zip(*of_source, strict=True))
        adapted.estimate_target_statistics()
        found = [adapted.network(x)[:, -1].detach() for x in adaptation.target_batches(0)]
        self.edges = np.unique(np.quantile(true, np.linspace(0, 1, self.settings.bins + 1)[1:-1]))
        bins = [np.searchsorted(self.edges, x) for x in (true, predicted, torch.cat(found).cpu().numpy())]
        weights = shift_weights(*bins, len(self.edges) + 1, self.settings.pull)
        self.weights = torch.from_numpy(weights).float()
        super().adapt(adaptation)

    def loss(self, source: Activations, target: Activations, step: Step) -> TransferLoss:
        rows = torch.from_numpy(np.searchsorted(self.edges, source.force[:, -1].cpu().numpy()))
        weight = self.weights[rows].to(source.force)
        error = (source.prediction - source.force).square().mean(dim=1)
        value = ((weight - 1) * error).mean()
        return TransferLoss(
            value, step.weight, {"largest_weight": weight.max(), "least_weight": weight.min()}
        )
