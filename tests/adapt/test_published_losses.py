"""Losses against values and gradients of public code: equal, or apart by what is named."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import torch

from gelgap.adapt.methods.rsd import projection_distance
from gelgap.benchmarks.adaptation import published_losses
from gelgap.benchmarks.adaptation.published_losses import (
    CASES,
    COMPARISONS,
    TOLERANCE,
    agreement,
    daregram_beside_its_cut,
    inputs_of,
    method_loss,
    published_arrays,
    run,
)

# The DSAN authors' weights are float32.
LOOSE = {"dsan": 1e-6, "ssa": TOLERANCE}
EQUAL = [c for c in COMPARISONS if not c.deviation]
DEVIATING = [c for c in COMPARISONS if c.deviation]


@pytest.mark.parametrize("comparison", EQUAL, ids=lambda c: f"{c.loss} / {c.public_code}")
def test_value_and_gradient_are_those_of_public_code(comparison):
    found = agreement(comparison)
    tolerance = LOOSE.get(comparison.loss, 1e-10)
    assert found.value < tolerance
    assert found.gradient < tolerance


@pytest.mark.parametrize("comparison", DEVIATING, ids=lambda c: f"{c.loss} / {c.public_code}")
def test_a_deviation_is_named_only_where_there_is_one(comparison):
    found = agreement(comparison)
    assert found.value > 0.01
    assert found.gradient > 0.01


@pytest.mark.parametrize("case", CASES)
def test_rsd_is_of_the_published_angles(case):
    """Published: Σ sin θ, without the mismatch of the bases. Ours: Σ sin²θ of the same angles."""
    arrays = published_arrays()
    source, target = (arrays[f"{case}/input/{name}"] for name in ("source", "target"))
    bases = [np.linalg.qr(x.T)[0] for x in (source, target)]
    cosines = np.clip(np.linalg.svd(bases[0].T @ bases[1], compute_uv=False), 0, 1)
    sines = np.sqrt(1 - cosines**2)
    assert sines.sum() == pytest.approx(float(arrays[f"{case}/rsd-angles/value"]), rel=1e-9)
    ours = projection_distance(torch.from_numpy(source), torch.from_numpy(target), ridge=1e-12)
    assert float(ours) == pytest.approx((sines**2).sum(), rel=1e-6)


@pytest.mark.parametrize("case", CASES)
def test_daregram_as_published_falls_on_one_side_of_its_cut(case):
    """Discontinuous by definition: the cut lies on a singular value of either domain, and rounding decides."""
    x = inputs_of(published_arrays(), case, "daregram")
    sides = [float(daregram_beside_its_cut(x, extra).detach()) for extra in product((0, 1), repeat=2)]
    assert np.diff(sorted(sides)).min() > 1e-3 * max(sides)
    found = float(method_loss("daregram-published")(x).detach())
    assert min(abs(found / side - 1) for side in sides) < 1e-10


def test_the_command_names_every_deviation_and_fails_on_one_without_a_name(tmp_path, monkeypatch, capsys):
    run(quick=True, out_dir=tmp_path)
    printed = capsys.readouterr().out
    assert printed.count(" none ") == len(EQUAL)
    monkeypatch.setattr(published_losses, "COMPARISONS", (replace(DEVIATING[0], deviation=""),))
    with pytest.raises(RuntimeError, match="dan should equal public code and does not"):
        run(quick=True, out_dir=tmp_path)
