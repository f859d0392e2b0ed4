"""Losses: equal to public code or apart by what is named; gradients; and sane on degenerate batches.

The published values are numbers in `assets/reference/losses`, whose README names repository, commit and settings. Run
as a program, this file prints the table of docs/adaptation.md.
"""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from gelgap.adapt.methods.base import Activations, Step
from gelgap.adapt.methods.dann import CDAN, DANN, domain_loss, multilinear_map, reverse_gradient
from gelgap.adapt.methods.daregram import daregram
from gelgap.adapt.methods.mmd import (
    DSAN,
    bandwidth,
    joint_mmd,
    lmmd,
    mk_mmd,
    mmd_of_kernel,
    multi_gaussian,
    squared_distances,
)
from gelgap.adapt.methods.registry import find_method
from gelgap.adapt.methods.uga import Evidence, evidential_loss, similar
from gelgap.assets import asset_path
from gelgap.assets.array_file import read_arrays

pytestmark = pytest.mark.numerical

PUBLISHED = read_arrays(asset_path("reference", "losses", "published.npz"))
"""What public code gave, by `case/loss/quantity`, and its inputs by `case/input/name`."""
GUIDE = Path(__file__).parents[2] / "docs" / "adaptation.md"
CASES = (0, 1)
REVERSAL = 0.3
"""Weight of the reversed gradient when the published values were computed."""
TLLIB_PREDICTION_SIGMA = 0.92
# The DSAN authors' weights are float32.
LOOSE = {"dsan": 1e-6}
Inputs = dict[str, Tensor]
"""The inputs of a case by name, in float64; those that have a published gradient require one."""


def method_loss(name: str, **settings: float) -> Callable[[Inputs], Tensor]:
    """Return the transfer loss of a method, with some settings given, as a function of the inputs."""

    def loss(x: Inputs) -> Tensor:
        kind = find_method(name)
        method = kind(kind.Settings(**settings), x["source"].shape[1], x["target_logits"].shape[1])
        return method.loss(*activations(x), Step(number=0, weight=1.0, rng=np.random.default_rng(0))).value

    return loss


def activations(x: Inputs) -> tuple[Activations, Activations]:
    labels = {"force": x["source_force"], "contact_class": x["source_class"]}
    source = Activations(x["source"], x["source_prediction"], **labels)
    return source, Activations(x["target"], x["target_prediction"], logits=x["target_logits"])


def tllib_mmd(x: Inputs, *factors: Tensor) -> Tensor:
    """Return MMD by tllib's five kernels: the mean distance is over all pairs, also of a frame with itself."""
    distances = squared_distances(torch.cat([x["source"], x["target"]]))
    kernel = multi_gaussian(distances, distances.detach().mean())
    for factor in factors:
        kernel = kernel * factor
    n = len(x["source"])
    return mmd_of_kernel(kernel, n, unbiased=True) + 2 / (n - 1)


def jan_as_tllib(x: Inputs) -> Tensor:
    distances = squared_distances(torch.cat([x["source_prediction"], x["target_prediction"]]))
    return tllib_mmd(x, torch.exp(-distances / (2 * TLLIB_PREDICTION_SIGMA**2)))


class Discriminator(torch.nn.Module):
    """One hidden layer whose weights are given, without biases."""

    def __init__(self, hidden: Tensor, output: Tensor) -> None:
        super().__init__()
        self.hidden, self.output = hidden, output

    def forward(self, features: Tensor) -> Tensor:
        return (torch.relu(features @ self.hidden) @ self.output)[:, None]


def adversarial(x: Inputs) -> Tensor:
    dann = DANN(DANN.Settings(), x["source"].shape[1], 1)
    dann.discriminator = Discriminator(x["hidden"], x["output"])
    step = Step(number=0, weight=REVERSAL, rng=np.random.default_rng(0))
    return dann.loss(*activations(x), step).value


def conditional_adversarial(x: Inputs) -> Tensor:
    joint = multilinear_map(torch.cat([x["source"], x["target"]]), x["conditioning_logits"].softmax(dim=1))
    logits = reverse_gradient(joint, REVERSAL) @ x["conditional_output"]
    return domain_loss(*logits.split(len(x["source"])))


def rank_of_the_authors(x: Inputs) -> int:
    """Return how many singular values DARE-GRAM's authors keep, where rounding does not drop one more."""
    ranks = []
    for features in (x["source"], x["target"]):
        a = torch.cat([torch.ones(len(features), 1), features.detach()], dim=1)
        values = torch.linalg.svdvals(a.T @ a)
        shares = values.cumsum(dim=0) / values.sum()
        ranks.append(int((shares <= max(0.9, float(shares[1]))).sum()) - 1)
    return max(*ranks, 1)


def evidential(x: Inputs) -> Tensor:
    nu, alpha, beta = (x["evidence"] + torch.tensor([0.0, 1.0, 0.0]) + 1e-5).unbind(dim=2)
    return evidential_loss(x["source_force"], x["source_prediction"], Evidence(nu, alpha, beta))


EQUAL = (
    ("dan", "DSAN's authors, DAN", "mmd", method_loss("dan")),
    ("dan, as tllib", "tllib", "mmd-tllib", tllib_mmd),
    ("jan, as tllib", "tllib", "jmmd-tllib", jan_as_tllib),
    ("dsan", "DSAN's authors", "lmmd", method_loss("dsan")),
    ("dann", "tllib", "dann", adversarial),
    ("cdan, given class probabilities", "tllib", "cdan", conditional_adversarial),
    ("uga, evidential part", "UGA's authors", "uga", evidential),
)
"""Losses that equal public code: name, whose code, name of the published values, and ours."""
DEVIATIONS = {
    ("dan", "tllib", "mmd-tllib"): "V- for U-statistic + 2/(n−1); bandwidth over pairs of distinct frames",
    ("jan", "tllib", "jmmd-tllib"): "as dan; five kernels on the prediction for one of σ = 0.92",
    ("daregram", "DARE-GRAM's authors", "daregram"): "cut in a gap of the spectrum",
}
"""What methods do otherwise than public code."""


def inputs_of(case: int, published: str) -> Inputs:
    """Return the inputs of a case; those that the published loss has a gradient of require one."""
    own, gradients = f"{case}/input/", f"{case}/{published}/gradient/"
    named = {name.removeprefix(own): array for name, array in PUBLISHED.items() if name.startswith(own)}
    return {
        name: torch.from_numpy(array).clone().requires_grad_(gradients + name in PUBLISHED)
        for name, array in named.items()
    }


def differences(published: str, ours: Callable[[Inputs], Tensor]) -> tuple[float, float]:
    """Return the largest relative differences from public code, of the value and, by its norm, the gradient."""
    values, gradients = [], []
    for case in CASES:
        x = inputs_of(case, published)
        value = ours(x)
        value.backward()
        expected = float(PUBLISHED[f"{case}/{published}/value"])
        values.append(abs(float(value.detach()) - expected) / abs(expected))
        for name in (name for name in x if x[name].requires_grad):
            theirs = PUBLISHED[f"{case}/{published}/gradient/{name}"]
            found = np.zeros_like(theirs) if x[name].grad is None else x[name].grad.numpy()
            gradients.append(float(np.linalg.norm(found - theirs) / np.linalg.norm(theirs)))
    return max(values), max(gradients)


def guide_row(name: str, code: str, value: float, gradient: float, deviation: str) -> str:
    return f"| {name} | {code} | {value:.0e} | {gradient:.0e} | {deviation} |"


@pytest.mark.parametrize(("name", "code", "published", "ours"), EQUAL, ids=[one[0] for one in EQUAL])
def test_value_and_gradient_are_those_of_public_code(name, code, published, ours):
    assert max(differences(published, ours)) < LOOSE.get(name, 1e-10)
    (row,) = (line for line in GUIDE.read_text().splitlines() if line.startswith(f"| {name} | {code} |"))
    assert row.endswith(" none |")


@pytest.mark.parametrize("deviation", DEVIATIONS, ids=" / ".join)
def test_a_deviation_is_named_only_where_there_is_one(deviation):
    name, code, published = deviation
    found = differences(published, method_loss(name))
    assert min(found) > 0.01
    assert guide_row(name, code, *found, DEVIATIONS[deviation]) in GUIDE.read_text()


@pytest.mark.parametrize("case", CASES)
def test_daregram_at_the_authors_rank_has_their_value(case):
    """Published, the cut lies on a singular value, and rounding decides; the gradient there ignores the cut."""
    x = inputs_of(case, "daregram")
    found = daregram(x["source"], x["target"], 0.05, 0.001, 0.9, rank=rank_of_the_authors(x))
    assert float(found.detach()) == pytest.approx(float(PUBLISHED[f"{case}/daregram/value"]), rel=1e-10)


BATCH, FEATURES, CLASSES = 32, 256, 361
OUTLIER = 1e4


def discriminated(source: Tensor, target: Tensor) -> Tensor:
    torch.manual_seed(0)
    discriminator = DANN(DANN.Settings(), source.shape[1], n_classes=1).discriminator.to(source.dtype)
    logits = discriminator(torch.cat([source, target]))[:, 0]
    return domain_loss(logits[: len(source)], logits[len(source) :])


def subdomains(source: Tensor, target: Tensor, robust: bool = False, shift: int = 0) -> Tensor:
    """Return LMMD where frame i is of class i modulo 20; a shift leaves the domains no class in common."""
    of_source, of_target = torch.zeros(len(source), CLASSES), torch.zeros(len(target), CLASSES)
    of_source[torch.arange(len(source)), torch.arange(len(source)) % 20] = 1
    of_target[torch.arange(len(target)), torch.arange(len(target)) % 20 + shift] = 1
    common = of_source.any(dim=0) & of_target.any(dim=0)
    return lmmd(source, target, of_source.to(source), of_target.to(target), common, robust=robust)


LOSSES = {
    "dann": discriminated,
    "dan": mk_mmd,
    "dan, median": lambda s, t: mk_mmd(s, t, robust=True),
    "jan": lambda s, t: joint_mmd((s, s[:, :3]), (t, t[:, :3])),
    "dsan": subdomains,
    "dsan, median": lambda s, t: subdomains(s, t, robust=True),
    "dsan, no common class": lambda s, t: subdomains(s, t, shift=100),
    "daregram": lambda s, t: daregram(s, t, 0.5, 0.003, 0.9),
}


def traps() -> dict[str, tuple[Tensor, Tensor]]:
    """Return pairs of batches in float32 on which losses go wrong; the first is an ordinary one."""
    generator = torch.Generator().manual_seed(0)
    s = torch.rand(BATCH, FEATURES, generator=generator)
    t = torch.rand(BATCH, FEATURES, generator=generator) * 1.3
    outlier = t.clone()
    outlier[0] = OUTLIER
    wide = torch.rand(2 * FEATURES, FEATURES, generator=generator)
    units = torch.arange(FEATURES)
    return {
        "random": (s, t),
        "identical": (s, s.clone()),
        "permuted rows": (s, s.flip(0)),
        "constant": (torch.ones_like(s), 2 * torch.ones_like(s)),
        "all zero": (torch.zeros_like(s), torch.zeros_like(s)),
        "duplicated rows": (s[: BATCH // 2].repeat(2, 1), t),
        "repeated singular values": (torch.eye(BATCH, FEATURES), torch.eye(BATCH, FEATURES).roll(9, 1)),
        "batch > dimension": (wide, 1.3 * wide.flip(1)),
        "dead units": (s * (units > 99), t * (units > 49)),
        "one outlier at 1e4": (s, outlier),
        "offset 1e4": (s + OUTLIER, t + OUTLIER),
        "unequal batches": (s, t[:13]),
        "scale 1e-6": (1e-6 * s, 1e-6 * t),
        "scale 1e6": (1e6 * s, 1e6 * t),
        "bfloat16 features": (s.bfloat16().float(), t.bfloat16().float()),
    }


def should_be_zero(loss: str, trap: str) -> bool:
    equal = ("identical", "all zero", *(["permuted rows"] if "dsan" not in loss else []))
    # The discriminator's loss is ln 2 where it cannot tell the domains apart.
    return loss == "dsan, no common class" or (trap in equal and loss != "dann")


KNOWN_LIMIT = ("daregram", "repeated singular values")
"""Where all singular values are equal, no cut of the spectrum lies in a gap, and which vectors it keeps is a matter of
rounding."""


@pytest.mark.parametrize("loss", LOSSES)
def test_value_and_gradient_on_degenerate_batches(loss: str) -> None:
    """Finite, exact in float32, and zero where they should be."""
    for trap, batches in traps().items():
        if (loss, trap) == KNOWN_LIMIT:
            continue
        source, target = batches[0].clone().requires_grad_(True), batches[1]
        value = LOSSES[loss](source, target)
        value.backward()
        value, exact = value.item(), LOSSES[loss](source.detach().double(), target.double()).item()
        assert math.isfinite(value), trap
        assert torch.isfinite(source.grad).all(), trap
        if should_be_zero(loss, trap):
            assert abs(value) < 1e-4, trap
        else:
            assert value != 0, trap
            assert abs(value - exact) < 1e-2 * max(abs(exact), 1e-3), trap


def test_a_known_limit_is_a_jump() -> None:
    """Changes of 1e-9, far above rounding, so that no processor's rounding decides which side of a jump is seen."""
    source, target = (batch.double() for batch in traps()[KNOWN_LIMIT[1]])
    values = []
    for seed in range(6):
        generator = torch.Generator().manual_seed(seed)
        noise = torch.randn(source.shape, generator=generator, dtype=torch.float64)
        values.append(float(LOSSES["daregram"](source + 1e-9 * noise, target)))
    assert max(values) - min(values) > 1e-4 * max(values)


def features(n: int = 9, d: int = 12, seed: int = 0, shift: float = 0.0) -> Tensor:
    return torch.from_numpy(np.random.default_rng(seed).standard_normal((n, d)) + shift)


# A kernel's bandwidth carries no gradient by definition: kernels are checked with a fixed one below.
def test_gradient_against_finite_differences() -> None:
    s, t = features(5, 7).requires_grad_(True), features(5, 7, seed=1, shift=0.3)
    assert torch.autograd.gradcheck(lambda s: LOSSES["daregram"](s, t), (s,), eps=1e-6, atol=1e-7, rtol=1e-4)


def test_kernel_gradient_against_finite_differences() -> None:
    s, t = features(4, 3).requires_grad_(True), features(5, 3, seed=1)
    weights = torch.from_numpy(np.random.default_rng(2).standard_normal((9, 9)))

    def value(s: Tensor) -> Tensor:
        return (weights * multi_gaussian(squared_distances(torch.cat([s, t])), torch.tensor(2.0))).sum()

    assert torch.autograd.gradcheck(value, (s,), eps=1e-6, atol=1e-7)


def test_one_outlier_moves_the_mean_bandwidth_not_the_median() -> None:
    s, t = features(16), features(16, seed=1)
    far = t.clone()
    far[0] = 1e4
    plain, spoiled = (squared_distances(torch.cat([s, x])) for x in (t, far))
    assert bandwidth(spoiled, robust=False) > 1e4 * bandwidth(plain, robust=False)
    assert bandwidth(spoiled, robust=True) < 1.5 * bandwidth(plain, robust=True)


def test_jan_with_one_layer_is_dan() -> None:
    s, t = features(), features(seed=1)
    torch.testing.assert_close(joint_mmd((s,), (t,)), mk_mmd(s, t))


def test_stable_daregram_is_the_definition_at_a_gap() -> None:
    # Four strong directions, a constant and weak noise: the rank is 5, and pinv can cut in the gap.
    rng = np.random.default_rng(0)

    def batch() -> Tensor:
        strong = rng.standard_normal((10, 4)) @ (5 * rng.standard_normal((4, 15)))
        return torch.from_numpy(strong + 1e-3 * rng.standard_normal((10, 15)))

    def gram(x: Tensor) -> Tensor:
        a = torch.cat([torch.ones(10, 1), x], dim=1)
        return a.T @ a

    s, t = batch(), batch()
    inverse_s, inverse_t = (torch.linalg.pinv(gram(x), rtol=1e-6, hermitian=True) for x in (s, t))
    angle = (1 - torch.cosine_similarity(inverse_s, inverse_t, dim=0, eps=1e-30)).abs().mean()
    values_s, values_t = (torch.linalg.eigvalsh(gram(x)).flip(0)[:5] for x in (s, t))
    expected = 0.5 * angle + 0.003 * torch.dist(values_s, values_t) / 5
    assert float(daregram(s, t, 0.5, 0.003, 0.9999)) == pytest.approx(float(expected), rel=1e-6)


STEP = Step(number=0, weight=0.5, rng=np.random.default_rng(0))


def brute_force_lmmd(s, t, source_group, target_probability):
    """LMMD by loops over classes and frames; a class counts that both batches have, by label and by argmax."""
    distances = squared_distances(torch.cat([s, t]))
    kernel = multi_gaussian(distances, bandwidth(distances, False)).tolist()
    of_source, of_target = source_group.tolist(), target_probability.tolist()
    guessed = [row.index(max(row)) for row in of_target]
    common, n = sorted(set(of_source) & set(guessed)), len(of_source)
    total = 0.0
    for c in common:
        w_s = [float(group == c) / of_source.count(c) for group in of_source]
        mass = sum(row[c] for row in of_target)
        signed = w_s + [-row[c] / mass for row in of_target]
        total += sum(signed[i] * signed[j] * kernel[i][j] for i in range(2 * n) for j in range(2 * n))
    return total / max(len(common), 1), common


def dsan_batches(n_classes, classes, seed=0):
    """Activations of 8 frames each, source frames of the classes given, targets with softmax labels."""
    rng = np.random.default_rng(seed)
    s, t = (torch.from_numpy(rng.standard_normal((8, 12)) + shift).float() for shift in (0.0, 0.3))
    logits = torch.from_numpy(2 * rng.standard_normal((8, n_classes))).float()
    prediction = torch.full((8, 3), 0.5)
    source = Activations(s, prediction, contact_class=torch.tensor(classes))
    return source, Activations(t, prediction, logits=logits)


def test_dsan_aligns_the_classes_of_the_source_that_are_argmax_in_the_target():
    seed = 0
    rng = np.random.default_rng(seed)
    source, target = dsan_batches(12, rng.integers(0, 12, 8).tolist(), seed)
    dsan = DSAN(DSAN.Settings(), 12, 12)
    expected, common = brute_force_lmmd(
        source.features, target.features, source.contact_class, target.logits.softmax(dim=1)
    )
    present = len(set(source.contact_class.tolist()))
    assert 0 < len(common) < present
    found = dsan.loss(source, target, STEP)
    assert found.weight == STEP.weight
    assert float(found.value) == pytest.approx(expected, rel=1e-4)
    assert found.diagnostics == {"common_classes": len(common), "no_common_class": 0}


def test_dsan_without_a_common_class_has_no_loss_and_says_so():
    source, target = dsan_batches(6, 8 * [5])
    target.logits[:, 5] = -9.0
    source.features.requires_grad_(True)
    dsan = DSAN(DSAN.Settings(), 12, 6)
    found = dsan.loss(source, target, STEP)
    found.value.backward()
    assert found.value.item() == 0
    assert not source.features.grad.any()
    assert found.diagnostics == {"common_classes": 0, "no_common_class": 1}


def adversarial_activations(features: torch.Tensor) -> Activations:
    return Activations(features=features, prediction=features[:, :3].sigmoid())


def test_the_features_gradient_is_minus_lambda_times_the_discriminators():
    generator = torch.Generator().manual_seed(0)
    s, t = (torch.rand(12, 6, generator=generator, dtype=torch.float64) for _ in range(2))
    dann = DANN(DANN.Settings(), 6, 1).double().eval()
    plain = s.clone().requires_grad_(True)
    logits = dann.discriminator(torch.cat([plain, t]))[:, 0]
    domain_loss(logits[:12], logits[12:]).backward()
    of_discriminator = [p.grad.clone() for p in dann.discriminator.parameters()]
    for weight in (1.0, 0.003, 0.0):
        step = Step(number=0, weight=weight, rng=np.random.default_rng(0))
        dann.zero_grad()
        features = s.clone().requires_grad_(True)
        found = dann.loss(adversarial_activations(features), adversarial_activations(t), step)
        assert found.weight == 1
        found.value.backward()
        torch.testing.assert_close(features.grad, -weight * plain.grad, rtol=1e-12, atol=0)
        for ours, full in zip(dann.discriminator.parameters(), of_discriminator, strict=True):
            torch.testing.assert_close(ours.grad, full, rtol=1e-12, atol=0)


def test_cdan_shows_the_feature_given_a_force_that_it_does_not_move():
    features, prediction = (torch.rand(6, width, requires_grad=True) for width in (4, 3))
    cdan = CDAN(CDAN.Settings(), 4, 1)
    shown = cdan.conditioned(features, Activations(features, prediction))
    shown.square().sum().backward()
    assert features.grad.any()
    assert prediction.grad is None
    expected = torch.cat([features, *(features * force[:, None] for force in prediction.T)], dim=1)
    torch.testing.assert_close(shown, expected)


def test_the_evidential_loss_is_least_near_the_force_and_honest_evidence():
    force = torch.full((1, 3), 0.5)

    def loss(prediction: float, beta: float) -> float:
        evidence = Evidence(*(torch.full((1, 3), value) for value in (1.0, 2.0, beta)))
        return float(evidential_loss(force, torch.full((1, 3), prediction), evidence))

    assert loss(0.5, 0.01) < loss(0.7, 0.01)
    assert loss(0.7, 0.04) < loss(0.7, 1e-4), "a wrong force with little spread costs more"


def test_frames_are_mixed_with_those_of_similar_force():
    pool = torch.tensor([[0.1, 0.5, 0.5], [0.9, 0.5, 0.5]])
    queries = torch.tensor([[0.1, 0.5, 0.5], [0.9, 0.5, 0.5]]).repeat(50, 1)
    uniform = torch.rand(100, generator=torch.Generator().manual_seed(0))
    partners = similar(queries, pool, 0.1, uniform)
    assert partners.tolist() == [0, 1] * 50
    assert set(similar(queries, pool, 100.0, uniform).tolist()) == {0, 1}


if __name__ == "__main__":
    for name, code, published, ours in EQUAL:
        print(guide_row(name, code, *differences(published, ours), "none"))
    for (name, code, published), deviation in DEVIATIONS.items():
        print(guide_row(name, code, *differences(published, method_loss(name)), deviation))
