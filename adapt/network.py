"""The force network: backbone, bottleneck, regression head and contact classifier (the paper's figure 2)."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from gelgap.adapt.profile import Profile
from gelgap.adapt.resnet import make_resnet


@dataclass(frozen=True)
class Activations:
    """The network's output for a batch of B frames of one domain, and their known labels.

    inputs (B, channels, h, w) before a method perturbed them; features (B, D) after the bottleneck's ReLU, prediction
    (B, k) in [0, 1], logits (B, C) where the method uses the classifier; force (B, k) in [0, 1] and contact_class (B,)
    only where labels may be used. k is 3, the axes of the force, unless a run has other labels; these take their place.
    """

    features: Tensor
    prediction: Tensor
    logits: Tensor | None = None
    force: Tensor | None = None
    contact_class: Tensor | None = None
    inputs: Tensor | None = None


class ForceNetwork(nn.Module):
    """ResNet → Linear + ReLU (the transfer feature) → Linear + Sigmoid (labels) and Linear (contact class).

    The classifier has no ReLU: in front of cross-entropy it would stop the gradient of every negative
    true-class logit.
    """

    def __init__(self, profile: Profile, n_classes: int, n_labels: int = 3) -> None:
        super().__init__()
        self.n_labels = n_labels
        self.backbone = make_resnet(profile.backbone, profile.in_channels, profile.width)
        self.bottleneck = nn.Sequential(
            nn.Linear(self.backbone.out_features, profile.feature_dim), nn.ReLU(inplace=True)
        )
        self.regressor = nn.Sequential(nn.Linear(profile.feature_dim, n_labels), nn.Sigmoid())
        self.classifier = nn.Linear(profile.feature_dim, n_classes)

    def features(self, pictures: Tensor) -> Tensor:
        """Return the transfer features (B, D) of network inputs (B, channels, h, w)."""
        return self.bottleneck(self.backbone(pictures))

    def forward(self, pictures: Tensor) -> Tensor:
        """Return the normalised labels (B, k) in [0, 1]."""
        return self.regressor(self.features(pictures))

    def head_parameters(self) -> list[nn.Parameter]:
        """Return the parameters outside the backbone; they learn at the full rate."""
        return [p for m in (self.bottleneck, self.regressor, self.classifier) for p in m.parameters()]


def make_network(profile: Profile, n_classes: int, seed: int, n_labels: int = 3) -> ForceNetwork:
    """Return an untrained network whose weights depend on `seed` alone, whatever was drawn before."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return ForceNetwork(profile, n_classes, n_labels).to(memory_format=torch.channels_last)
