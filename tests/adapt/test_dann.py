"""Training with DANN: its discriminator learns whatever λ is, and λ reaches it before its loss."""

import pytest

from gelgap.adapt.methods.base import TransferLoss
from gelgap.adapt.methods.dann import DANN
from gelgap.adapt.trainer import adapt, train_source

pytestmark = pytest.mark.numerical


def test_the_discriminator_tells_separable_domains_apart_whatever_lambda(source, tinted, profile):
    """With λ on the whole loss it would learn a thousand times more slowly, and not at all in the warm-up."""
    weak = profile.replace(
        pairing="channels",
        source_epochs=3,
        adapt_epochs=10,
        adapt_learning_rate=0.05,
        transfer_warmup=0.8,
        transfer_weight=0.003,
    )
    history = adapt(train_source(source, weak, seed=2), source, tinted, "dann").history[-10:]
    accuracy = [record["diagnostics"]["discriminator_accuracy"] for record in history]
    assert accuracy[0] < 0.7
    # Means over epochs: a single one moves by 0.1 and more with the rounding of another processor.
    assert sum(accuracy[4:8]) / 4 > 0.85
    assert sum(accuracy[8:]) / 2 > 0.85


def test_a_records_diagnostics_are_means_over_the_epochs_steps(source, target, profile, monkeypatch):
    seen = []

    def loss(self, source, target, step):
        seen.append(float(len(seen)))
        value = (source.features.mean(dim=0) - target.features.mean(dim=0)).square().sum()
        return TransferLoss(value, step.weight, {"calls": seen[-1]})

    monkeypatch.setattr(DANN, "loss", loss)
    short = profile.replace(source_epochs=1, adapt_epochs=1)
    record = adapt(train_source(source, short, seed=0), source, target, "dann").history[-1]
    assert record["diagnostics"]["calls"] == pytest.approx(sum(seen) / len(seen))
    assert len(seen) > 2


def test_lambda_reaches_the_method_before_its_loss(source, target, profile, monkeypatch):
    seen = []

    def loss(self, source, target, step):
        seen.append(step.weight)
        return TransferLoss(source.features.sum() * 0, 1.0)

    monkeypatch.setattr(DANN, "loss", loss)
    short = profile.replace(source_epochs=1, adapt_epochs=2, transfer_warmup=0.5)
    adapt(train_source(source, short, seed=0), source, target, "dann")
    half = len(seen) // 2
    assert seen[:half] == half * [0.0]
    assert seen[half:] == sorted(seen[half:])
    assert seen[-1] == pytest.approx(short.transfer_weight, rel=1e-3)
