"""
Your own feature extractor
==========================

Train and adapt a network of your own: a function that is given the number of channels and returns a `torch.nn.Module`.
"""

import sys
from pathlib import Path

from torch import nn

from gelgap.adapt import Profile, adapt_folders, use_backbone


def make_backbone(in_channels: int) -> nn.Module:
    """Return four strided convolutions, whose maps (n, 64, h, w) gelgap averages to features."""
    layers: list[nn.Module] = []
    for channels in (16, 32, 64, 64):
        layers += [nn.Conv2d(in_channels, channels, 3, 2, 1), nn.BatchNorm2d(channels), nn.ReLU()]
        in_channels = channels
    return nn.Sequential(*layers)


def mobilenet(in_channels: int) -> nn.Module:
    """Return a network of the package timm, which is not among gelgap's: pip install timm."""
    import timm

    return timm.create_model("mobilenetv3_small_050", in_chans=in_channels, num_classes=0)


def main(source: Path, target: Path, function: str = "make_backbone", profile: str = "smoke") -> None:
    own = use_backbone(f"{__file__}:{function}")
    runs = adapt_folders(
        source, target, ("source-only", "adabn"), profile=Profile.preset(profile).replace(backbone=own)
    )
    for run in runs:
        if run.target_test is not None:  # a target without labels has no error
            print(f"{function} {run.method:<12} mean error on the target {run.target_test.mean_mae_n:.3f} N")


if __name__ == "__main__":
    folders = sys.argv[1:3] if len(sys.argv) > 2 else ("data/mb0i0", "data/wmb1i1")
    main(Path(folders[0]), Path(folders[1]), *sys.argv[3:])
