"""All numbers of a model's network in one array, to compare trainings by."""

import numpy as np
import torch

from gelgap.adapt.model import ForceModel


def weights(model: ForceModel) -> np.ndarray:
    """Return the network's parameters and buffers (n,) float32."""
    return torch.cat([value.flatten().float() for value in model.network.state_dict().values()]).numpy()
