"""Fourier style transfer: source pictures take the low frequencies' amplitudes from target pictures [1].

Stage 2 trains on source frames in the target's style, without a loss between the domains. The exchange is that of the
authors' NumPy code, a window around the zero frequency, with a frame that is drawn from the target's batch.

[1] Yang, Soatto, "FDA: Fourier domain adaptation for semantic segmentation", CVPR 2020.
"""

import torch
from pydantic import Field
from torch import Tensor

from gelgap.adapt.methods.base import MethodSettings, Step
from gelgap.adapt.methods.controls import NoTransfer


def in_the_style_of(source: Tensor, target: Tensor, band: float) -> Tensor:
    """Return pictures (B, C, h, w) whose amplitudes up to ⌊band·min(h, w)⌋ waves a picture are another's."""
    height, width = source.shape[2:]
    waves = int(min(height, width) * band)
    spectrum, other = torch.fft.fft2(source), torch.fft.fft2(target)
    rows, columns = (
        torch.fft.fftfreq(n, 1 / n, device=source.device).abs() <= waves for n in (height, width)
    )
    amplitude = torch.where(rows[:, None] & columns, other.abs(), spectrum.abs())
    styled = torch.fft.ifft2(torch.polar(amplitude, spectrum.angle())).real
    return styled.to(memory_format=torch.channels_last)


class FourierStyle(NoTransfer):
    """Regression on source frames of which a share is shown in the style of target frames."""

    class Settings(MethodSettings):
        share: float = Field(
            default=1.0, ge=0, le=1, description="share of source frames in the target's style"
        )
        band: float = Field(
            default=0.05,
            ge=0,
            le=0.5,
            description="highest exchanged frequency, over the shorter side's pixels",
        )

    def augment_source(self, inputs: Tensor, target: Tensor, step: Step) -> Tensor:
        partner = torch.from_numpy(step.rng.integers(len(target), size=len(inputs))).to(inputs.device)
        chosen = torch.from_numpy(step.rng.random(len(inputs)) < self.settings.share).to(inputs.device)
        styled = in_the_style_of(inputs, target[partner], self.settings.band)
        return torch.where(chosen[:, None, None, None], styled, inputs)
