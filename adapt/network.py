"""The force network (the paper's figure 2), the files its weights come from, and the machine that it runs on.

Backbones are ResNets [1] with torchvision's state-dict keys, any number of input channels, any width.

[1] He, Zhang, Ren, Sun, "Deep residual learning for image recognition", CVPR 2016.
"""

import contextlib
import io
import warnings
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from gelgap.adapt.own_code import own_backbone
from gelgap.adapt.profile import Profile
from gelgap.assets.whole_file import write_whole

# A checkpoint stores its tensors as they are: a file that would take more than this times its size is not one.
_MOST_GROWTH = 2
_ZIP = b"PK\x03\x04"


class ForceNetwork(nn.Module):
    """Backbone → Linear + ReLU (the transfer feature) → Linear + Sigmoid (labels) and Linear (contact class).

    The frames of a sequence are channels of one picture: the first convolution sees how a dent has moved. A GRU of each
    frame's features took 1.6 times as long for two frames, and had more than twice the error of shear that these have.

    The classifier has no ReLU: in front of cross-entropy it would stop the gradient of every negative
    true-class logit.
    """

    def __init__(self, profile: Profile, n_classes: int, n_labels: int = 3) -> None:
        super().__init__()
        self.n_labels = n_labels
        if ":" in profile.backbone:
            self.backbone = OwnBackbone(profile.backbone, profile.input_shape)
        else:
            self.backbone = ResNet(profile.backbone, profile.input_shape[0], profile.width)
        self.bottleneck = nn.Sequential(
            nn.Linear(self.backbone.out_features, profile.feature_dim), nn.ReLU(inplace=True)
        )
        self.regressor = nn.Sequential(nn.Linear(profile.feature_dim, n_labels), nn.Sigmoid())
        self.classifier = nn.Linear(profile.feature_dim, n_classes)

    @property
    def device(self) -> torch.device:
        """Where its weights are."""
        return self.classifier.weight.device

    def features(self, pictures: Tensor) -> Tensor:
        """Return the transfer features (B, D) of network inputs (B, channels, h, w)."""
        return self.bottleneck(self.backbone(pictures))

    def forward(self, pictures: Tensor) -> Tensor:
        """Return the normalised labels (B, k) in [0, 1]."""
        return self.regressor(self.features(pictures))


def make_network(profile: Profile, n_classes: int, seed: int, n_labels: int = 3) -> ForceNetwork:
    """Return an untrained network whose weights depend on `seed` alone, whatever was drawn before."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return ForceNetwork(profile, n_classes, n_labels).to(memory_format=torch.channels_last)


RESNETS = {
    "resnet18": ((2, 2, 2, 2), ((1, 3), (1, 3))),
    "resnet50": ((3, 4, 6, 3), ((1, 1), (1, 3), (4, 1))),
}
"""Blocks of each layer, and a block's convolutions ([1], figure 5): channels over the layer's, and kernel size."""


def _convolution(n_in: int, n_out: int, size: int, stride: int) -> nn.Conv2d:
    return nn.Conv2d(n_in, n_out, size, stride, padding=size // 2, bias=False)


class Residual(nn.Module):
    """A block of convolutions (see `RESNETS`), the first 3×3 with the stride, and a shortcut around them."""

    def __init__(self, n_in: int, planes: int, stride: int, shape: Sequence[tuple[int, int]]) -> None:
        super().__init__()
        self.depth = len(shape)
        channels = n_in
        strided = [size for _, size in shape].index(3)
        for i, (factor, size) in enumerate(shape):
            convolution = _convolution(channels, factor * planes, size, stride if i == strided else 1)
            channels = factor * planes
            self.add_module(f"conv{i + 1}", convolution)
            self.add_module(f"bn{i + 1}", nn.BatchNorm2d(channels))
        self.out_features = channels
        self.downsample = nn.Sequential()
        if stride > 1 or channels != n_in:
            self.downsample = nn.Sequential(_convolution(n_in, channels, 1, stride), nn.BatchNorm2d(channels))

    def forward(self, x: Tensor) -> Tensor:
        residual = x
        for number in range(1, self.depth + 1):
            residual = getattr(self, f"bn{number}")(getattr(self, f"conv{number}")(residual))
            if number < self.depth:
                residual = functional.relu(residual, inplace=True)
        return functional.relu(residual + self.downsample(x), inplace=True)


class ResNet(nn.Module):
    """Untrained ResNet without its classifier: maps (B, in_channels, h, w) to the pooled feature (B, out_features).

    `width` scales the number of channels of every layer.
    """

    def __init__(self, name: str, in_channels: int = 3, width: float = 1.0) -> None:
        super().__init__()
        depths, shape = RESNETS[name]
        planes = [round(64 * 2**i * width) for i in range(4)]
        self.conv1 = nn.Conv2d(in_channels, planes[0], 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(planes[0])
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        n_in = planes[0]
        for i, depth in enumerate(depths):
            blocks = []
            for j in range(depth):
                blocks.append(Residual(n_in, planes[i], 2 if i > 0 and j == 0 else 1, shape))
                n_in = blocks[-1].out_features
            self.add_module(f"layer{i + 1}", nn.Sequential(*blocks))
        self.avgpool = nn.AdaptiveAvgPool2d(1)
        self.out_features = n_in
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, x: Tensor) -> Tensor:
        x = self.maxpool(self.relu(self.bn1(self.conv1(x))))
        x = self.layer4(self.layer3(self.layer2(self.layer1(x))))
        return self.avgpool(x).flatten(1)


class OwnBackbone(nn.Module):
    """A user's feature extractor for inputs (B, channels, h, w) of one shape; maps that it returns are averaged.

    Raises a ValueError if it cannot be made, or returns something else than features or maps.
    """

    def __init__(self, name: str, shape: tuple[int, int, int]) -> None:
        super().__init__()
        make = own_backbone(name)
        told_as = name.partition("#")[0]
        try:
            self.extractor = make(shape[0])
            if not isinstance(self.extractor, nn.Module):
                raise TypeError(f"it makes {type(self.extractor).__name__}, not a torch.nn.Module")
            with torch.no_grad():
                features = self.eval()(torch.zeros(2, *shape))
        except Exception as error:  # the user's code raises anything
            reason = " ".join(str(error).split())[:200]
            raise ValueError(
                f"backbone {told_as} fails for pictures {shape} ({type(error).__name__}: {reason})"
            ) from error
        if features.ndim != 2 or len(features) != 2:
            raise ValueError(
                f"backbone {told_as} returns {tuple(features.shape)} for 2 pictures {shape}; (2, features) or "
                "(2, channels, h, w) is needed"
            )
        self.out_features = features.shape[1]
        self.train()

    def forward(self, x: Tensor) -> Tensor:
        features = self.extractor(x)
        return features.mean(dim=(2, 3)) if features.ndim == 4 else features


def load_imagenet_weights(backbone: ResNet, path: str | Path) -> None:
    """Load a torchvision ResNet state dictionary from a file the user names (its `fc` layer is left out).

    A first convolution with 3·k input channels takes the file's filter repeated k times and divided by k,
    so that a picture repeated k times gives the response of the original network.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If the file does not fit this backbone (another depth or width).
    """
    state = {key: x for key, x in load_checkpoint(Path(path)).items() if not str(key).startswith("fc.")}
    filters = state.get("conv1.weight")
    channels = backbone.conv1.in_channels
    try:
        if filters is not None and filters.ndim == 4 and filters.shape[1] == 3 and channels % 3 == 0:
            state["conv1.weight"] = filters.repeat(1, channels // 3, 1, 1) * (3 / channels)
        backbone.load_state_dict(state)
    except (RuntimeError, AttributeError, TypeError) as error:
        reason = " ".join(str(error).split())[:200]
        raise ValueError(
            f"weights file {path} does not fit this backbone ({reason}); use the same depth and width=1"
        ) from None


def save_checkpoint(content: dict[str, Any], path: Path) -> None:
    """Write what `load_checkpoint` reads; where a disk is full, torch itself says nothing of the disk."""
    buffer = io.BytesIO()
    torch.save(content, buffer)
    write_whole(path, buffer.getvalue())


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Return the dictionary of a file that `save_checkpoint` wrote, on the CPU: tensors and plain values alone.

    torch itself reads a file with damaged weights without a word; the CRC-32 that the file keeps of each part is
    compared here. Files in the format before torch 1.6 have none.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is not a checkpoint, or is damaged; the message names it.
    """
    if not path.is_file():
        what = "is a folder; name its model.pt" if path.is_dir() else "does not exist"
        raise FileNotFoundError(f"checkpoint {path} {what}")
    try:
        with path.open("rb") as file:
            is_archive = file.read(len(_ZIP)) == _ZIP
        if is_archive:
            _check_archive(path)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about foreign bytes; the sentence below is enough
            content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # readers of foreign bytes raise anything
        reason = str(error).partition("\n")[0].partition(". ")[0]
        raise ValueError(f"{path} is not a checkpoint of torch ({type(error).__name__}: {reason})") from None
    if not isinstance(content, dict):
        raise ValueError(f"{path} is not a checkpoint: it holds {type(content).__name__}, not a dictionary")
    return content


def _check_archive(path: Path) -> None:
    """Raise a ValueError if a part of the archive is damaged, or all would take more memory than the file may."""
    with zipfile.ZipFile(path) as archive:
        total = sum(info.file_size for info in archive.infolist())
        if total > _MOST_GROWTH * path.stat().st_size:
            raise ValueError(f"it would take {total / 2**20:.0f} MiB")
        if damaged := archive.testzip():
            raise ValueError(f"the CRC-32 of {damaged!r} does not match")


def autocast(profile: Profile, device: torch.device) -> torch.autocast:
    """Return the context in which the backbone computes in the profile's precision."""
    return torch.autocast(device.type, torch.bfloat16, enabled=profile.precision == "bfloat16")


@contextlib.contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Run with `count` CPU threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
