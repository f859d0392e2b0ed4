"""Maps of the contact's force from a picture: a small dense head on the backbone of a trained force network.

The head sees the backbone's stem and first stage, which still know where things are, and the third, which knows what
they are.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import torch
from torch import Tensor, nn
from torch.nn import functional

from gelgap.adapt.data import Draw, epoch_order, network_inputs
from gelgap.adapt.model import ForceModel, estimate_statistics, input_map
from gelgap.adapt.network import ResNet, torch_threads
from gelgap.adapt.progress import Progress, silent
from gelgap.domains import GeneratedDomain, LabelledFrames

_HIDDEN, _LEARNING_RATE, _BATCH = 32, 2e-3, 32
# The error of the sum over all cells counts by this beside that of the cells, both in what is usual there.
_SUM_WEIGHT = 0.1
# Where the sums of an axis cancel, as those of straight presses do, this share of the largest axis' is usual.
_LEAST_SUM = 0.3


class TractionNetwork(nn.Module):
    """The first three stages of a ResNet, and a head: pictures (B, channels, h, w) become maps (B, 3, 24, 32).

    `places` (24, 32, 2) says where in the picture the cells' centres are: x and y from −1 to 1, beyond it outside.
    """

    def __init__(self, backbone: ResNet, places: np.ndarray) -> None:
        super().__init__()
        self.backbone = backbone
        self.register_buffer("places", torch.tensor(places, dtype=torch.float32))
        stem = backbone.conv1.out_channels
        seen = stem + backbone.layer1[-1].out_features + backbone.layer3[-1].out_features
        self.head = nn.Sequential(
            *(nn.Conv2d(seen, _HIDDEN, 3, padding=1), nn.ReLU(inplace=True)),
            *(nn.Conv2d(_HIDDEN, _HIDDEN, 3, padding=1), nn.ReLU(inplace=True)),
            nn.Conv2d(_HIDDEN, 3, 1),
        )

    def forward(self, pictures: Tensor) -> Tensor:
        """Return the maps in units of what is usual in a cell that carries load."""
        own = self.backbone
        stem = functional.relu(own.bn1(own.conv1(pictures)))
        where = own.layer1(own.maxpool(stem))
        what = own.layer3(own.layer2(where))
        places = self.places.expand(len(pictures), -1, -1, -1)
        seen = [functional.grid_sample(x, places, align_corners=False) for x in (stem, where, what)]
        return self.head(torch.cat(seen, dim=1))


@dataclass(frozen=True)
class TractionModel:
    """A network that maps pictures to forces on cells, in units of `usual_n` (3,), and the model that it began as."""

    network: TractionNetwork
    start: ForceModel
    usual_n: np.ndarray

    @torch.inference_mode()
    def predict_n(self, frames: LabelledFrames) -> np.ndarray:
        """Return the force (n, 24, 32, 3) in N on each cell."""
        self.network.eval()
        start = self.start
        pictures = network_inputs(frames, start.profile, start.device, start.input_map)
        parts = torch.arange(len(frames)).split(8 * _BATCH)
        maps = torch.cat([self.network(pictures.inputs(rows)).float().cpu() for rows in parts])
        return maps.permute(0, 2, 3, 1).numpy() * self.usual_n

    def with_statistics_of(self, frames: LabelledFrames) -> "TractionModel":
        """Return a copy whose normalisations have the statistics of these frames' pictures, as AdaBN does."""
        network, start = copy.deepcopy(self.network), self.start
        estimate_statistics(network, frames, start.profile, start.seed)
        return replace(
            self,
            network=network,
            start=replace(start, input_map=input_map(frames, start.profile, start.device)),
        )


def traction_maps_n(domain: GeneratedDomain, rows: Sequence[int]) -> np.ndarray:
    """Return the forces (n, 24, 32, 3) in N on each cell, of some frames of a domain.

    Raises
    ------
    ValueError
        If the domain was generated without the column.
    """
    return np.stack([domain.traction_map_n(int(row)) for row in rows])


def cell_places(domain: GeneratedDomain, shape: tuple[int, int]) -> np.ndarray:
    """Return where in a domain's pictures the centres of rows and columns of cells are, for `TractionNetwork`."""
    y_mm, x_mm = (
        half_mm * ((2 * np.arange(n) + 1) / n - 1)
        for half_mm, n in zip(domain.traction_half_extent_mm[::-1], shape, strict=True)
    )
    cells_mm = np.stack([*np.meshgrid(x_mm, y_mm), np.zeros(shape)], axis=-1).reshape(-1, 3)
    seen_px = domain.recipe.sensor.camera.project_px(cells_mm, domain.size_px)
    return (2 * seen_px / domain.size_px - 1).reshape(*shape, 2)


def learn_traction_maps(
    start: ForceModel,
    domain: GeneratedDomain,
    rows: Sequence[int],
    *,
    epochs: int = 40,
    progress: Progress = silent,
) -> TractionModel:
    """Train a dense head, and the backbone of a force network under it, on some frames of a domain by Adam.

    Raises
    ------
    ValueError
        If the backbone is not a ResNet, the domain was generated without tractions, or none of the frames carries load.
    """
    if not isinstance(start.network.backbone, ResNet):
        raise ValueError(f"maps of the force need a ResNet; the model's backbone is {start.profile.backbone}")
    maps_n = traction_maps_n(domain, rows)
    loaded = np.abs(maps_n).sum(axis=-1) > 0
    if not loaded.any():
        raise ValueError(
            f"{domain.name}: none of {len(maps_n)} frames carries load; there is nothing to learn"
        )
    usual_n = np.sqrt(np.square(maps_n[loaded]).mean(axis=0)).clip(min=1e-9)
    usual_sum = np.sqrt(np.square(maps_n.sum(axis=(1, 2)) / usual_n).mean(axis=0))
    usual_sum = usual_sum.clip(min=_LEAST_SUM * usual_sum.max())
    device, profile = start.device, start.profile
    pictures = network_inputs(domain.take(np.asarray(rows)), profile, device, start.input_map)
    wanted = torch.tensor(maps_n / usual_n, dtype=torch.float32, device=device).permute(0, 3, 1, 2)
    of_sum = torch.tensor(usual_sum, dtype=torch.float32, device=device)
    with torch.random.fork_rng(devices=[]), torch_threads(profile.threads):
        torch.manual_seed(start.seed)
        network = TractionNetwork(
            copy.deepcopy(start.network.backbone), cell_places(domain, maps_n.shape[1:3])
        ).to(device)
        optimizer = torch.optim.Adam(network.parameters(), _LEARNING_RATE)
        rate = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs)
        for epoch in range(epochs):
            network.train()
            for batch in epoch_order(len(maps_n), _BATCH, start.seed, Draw.FINE_TUNING, epoch):
                apart = network(pictures.inputs(torch.as_tensor(batch))) - wanted[batch]
                # Few cells carry load: their mean square is that of all, times how many there are for each.
                loss = apart.square().mean() / loaded.mean()
                loss = loss + _SUM_WEIGHT * (apart.sum(dim=(2, 3)) / of_sum).square().mean()
                optimizer.zero_grad(set_to_none=True)
                loss.backward()
                optimizer.step()
            rate.step()
            progress(f"traction {domain.name}", epoch + 1, epochs, f"loss {loss.item():.4f}")
    return TractionModel(network.eval(), start, usual_n)


def traction_errors(predicted_n: np.ndarray, maps_n: np.ndarray, mean_n: np.ndarray) -> pd.DataFrame:
    """Return the errors of predicted maps, and of the mean map (24, 32, 3) of the frames that were learnt.

    By axis: mean error of a cell that carries load, of any cell, in mN, and of the sum over the cells, in N.
    """
    loaded, rows = np.abs(maps_n).sum(axis=-1) > 0, {}
    for name, own in (("mean map", np.broadcast_to(mean_n, maps_n.shape)), ("predicted", predicted_n)):
        apart_n = np.abs(own - maps_n)
        of_sum_n = np.abs((own - maps_n).sum(axis=(1, 2))).mean(axis=0)
        rows[name] = [*1e3 * apart_n[loaded].mean(axis=0), *1e3 * apart_n.mean(axis=(0, 1, 2)), *of_sum_n]
    of = ("a loaded cell, mN", "a cell, mN", "the sum, N")
    return pd.DataFrame.from_dict(rows, "index", columns=[f"{axis}: {what}" for what in of for axis in "xyz"])
