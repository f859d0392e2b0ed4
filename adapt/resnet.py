"""ResNet-18 and ResNet-50 with torchvision's state-dict keys, any number of input channels, any width."""

from collections.abc import Sequence
from pathlib import Path

from torch import Tensor, nn

from gelgap.adapt.checkpoint import load_checkpoint


def _convolution(n_in: int, n_out: int, size: int, stride: int = 1) -> nn.Conv2d:
    return nn.Conv2d(n_in, n_out, size, stride, padding=size // 2, bias=False)


def _shortcut(n_in: int, n_out: int, stride: int) -> nn.Sequential | None:
    if stride == 1 and n_in == n_out:
        return None
    return nn.Sequential(_convolution(n_in, n_out, 1, stride), nn.BatchNorm2d(n_out))


class BasicBlock(nn.Module):
    """Two 3×3 convolutions and a shortcut (He et al. 2016, figure 5 left)."""

    expansion = 1

    def __init__(self, n_in: int, planes: int, stride: int = 1) -> None:
        super().__init__()
        self.conv1 = _convolution(n_in, planes, 3, stride)
        self.bn1 = nn.BatchNorm2d(planes)
        self.conv2 = _convolution(planes, planes, 3)
        self.bn2 = nn.BatchNorm2d(planes)
        self.relu = nn.ReLU(inplace=True)
        self.downsample = _shortcut(n_in, planes, stride)

    def forward(self, x: Tensor) -> Tensor:
        residual = self.bn2(self.conv2(self.relu(self.bn1(self.conv1(x)))))
        return self.relu(residual + (x if self.downsample is None else self.downsample(x)))


class Bottleneck(nn.Module):
    """1×1, 3×3, 1×1 convolutions and a shortcut (He et al. 2016, figure 5 right), stride on the 3×3."""

    expansion = 4

    def __init__(self, n_in: int, planes: int, stride: int = 1) -> None:
        super().__init__()
        n_out = planes * self.expansion
        self.conv1 = _convolution(n_in, planes, 1)
        self.bn1 = nn.BatchNorm2d(planes)
        self.conv2 = _convolution(planes, planes, 3, stride)
        self.bn2 = nn.BatchNorm2d(planes)
        self.conv3 = _convolution(planes, n_out, 1)
        self.bn3 = nn.BatchNorm2d(n_out)
        self.relu = nn.ReLU(inplace=True)
        self.downsample = _shortcut(n_in, n_out, stride)

    def forward(self, x: Tensor) -> Tensor:
        residual = self.relu(self.bn1(self.conv1(x)))
        residual = self.relu(self.bn2(self.conv2(residual)))
        residual = self.bn3(self.conv3(residual))
        return self.relu(residual + (x if self.downsample is None else self.downsample(x)))


class ResNet(nn.Module):
    """ResNet without its classifier (He et al., "Deep residual learning", CVPR 2016).

    `forward` maps (B, in_channels, h, w) to the pooled feature (B, out_features).
    """

    def __init__(
        self,
        block: type[BasicBlock] | type[Bottleneck],
        depths: Sequence[int],
        in_channels: int = 3,
        width: float = 1.0,
    ) -> None:
        super().__init__()
        planes = [round(64 * 2**i * width) for i in range(4)]
        self.conv1 = nn.Conv2d(in_channels, planes[0], 7, stride=2, padding=3, bias=False)
        self.bn1 = nn.BatchNorm2d(planes[0])
        self.relu = nn.ReLU(inplace=True)
        self.maxpool = nn.MaxPool2d(3, stride=2, padding=1)
        n_in = planes[0]
        for i, depth in enumerate(depths):
            blocks = []
            for j in range(depth):
                blocks.append(block(n_in, planes[i], stride=2 if i > 0 and j == 0 else 1))
                n_in = planes[i] * block.expansion
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


def make_resnet(name: str, in_channels: int = 3, width: float = 1.0) -> ResNet:
    """Return an untrained ResNet; `width` scales the number of channels of every layer."""
    if name == "resnet18":
        return ResNet(BasicBlock, (2, 2, 2, 2), in_channels, width)
    if name == "resnet50":
        return ResNet(Bottleneck, (3, 4, 6, 3), in_channels, width)
    raise ValueError(f"backbone {name!r} is unknown; known backbones: resnet18, resnet50")


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
    path = Path(path)
    state = {key: value for key, value in load_checkpoint(path).items() if not str(key).startswith("fc.")}
    if not all(isinstance(key, str) and isinstance(value, Tensor) for key, value in state.items()):
        raise ValueError(f"weights file {path} is no state dictionary: it holds more than named tensors")
    expected = backbone.state_dict()
    filters = state.get("conv1.weight")
    wanted = expected["conv1.weight"].shape[1]
    if filters is not None and filters.ndim == 4 and filters.shape[1] == 3 and wanted % 3 == 0:
        state["conv1.weight"] = filters.repeat(1, wanted // 3, 1, 1) * (3 / wanted)
    wrong = sorted(
        {key for key in expected if key not in state or state[key].shape != expected[key].shape}
        | (set(state) - set(expected))
    )
    if wrong:
        raise ValueError(
            f"weights file {path} does not fit this backbone: {len(wrong)} keys are missing, foreign or of "
            f"another shape (first: {wrong[0]}); use the same depth and width=1"
        )
    backbone.load_state_dict(state)
