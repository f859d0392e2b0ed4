"""Adaptation losses against public code: values and gradients on fixed inputs, and every deviation in words.

The published values are numbers in `assets/reference/losses`, whose README names repository, commit and settings.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gelgap.adapt import ResultTable
from gelgap.adapt.methods.base import Step
from gelgap.adapt.methods.cdan import multilinear_map
from gelgap.adapt.methods.dan import mmd_of_kernel, multi_gaussian, squared_distances
from gelgap.adapt.methods.dann import DANN, domain_loss, reverse_gradient
from gelgap.adapt.methods.daregram import daregram_cut_at, gram_spectra, published_rank
from gelgap.adapt.methods.registry import find_method
from gelgap.adapt.methods.ssa import subspace_loss
from gelgap.adapt.methods.uga import Evidence, evidential_loss
from gelgap.adapt.network import Activations
from gelgap.assets import asset_path
from gelgap.assets.array_file import read_arrays
from gelgap.benchmarks.adaptation.losses import rsd_published
from gelgap.benchmarks.common.tables import write_json

CASES = (0, 1)
REVERSAL = 0.3
"""Weight of the reversed gradient when the published values were computed."""
TLLIB_PREDICTION_SIGMA = 0.92
TOLERANCE = 2e-5
"""Largest relative difference of what should be equal: SSA's authors add 1e-8 to variances, we a millionth of them."""
Inputs = dict[str, Tensor]
"""The inputs of a case by name, in float64; those that have a published gradient require one."""


@dataclass(frozen=True)
class Comparison:
    """A loss of ours beside one of public code, and how it deviates; empty where it should be equal."""

    loss: str
    public_code: str
    published: str
    ours: Callable[[Inputs], Tensor]
    deviation: str = ""


@dataclass(frozen=True)
class Agreement:
    """Largest relative differences from public code, over the cases; the gradient's is by its norm."""

    loss: str
    public_code: str
    value: float
    gradient: float
    deviation: str


def published_arrays() -> dict[str, np.ndarray]:
    """Return what public code gave, by `case/loss/quantity`, and its inputs by `case/input/name`."""
    return read_arrays(asset_path("reference", "losses", "published.npz"))


def method_loss(name: str, **settings: float) -> Callable[[Inputs], Tensor]:
    """Return the transfer loss of a method, with some settings given, as a function of the inputs."""

    def loss(x: Inputs) -> Tensor:
        kind = find_method(name)
        method = kind(kind.Settings(**settings), x["source"].shape[1], x["target_logits"].shape[1])
        return method.loss(*_activations(x), _step(1.0)).value

    return loss


def _step(weight: float) -> Step:
    return Step(number=0, weight=weight, rng=np.random.default_rng(0))


def _activations(x: Inputs) -> tuple[Activations, Activations]:
    source = Activations(
        x["source"], x["source_prediction"], force=x["source_force"], contact_class=x["source_class"]
    )
    return source, Activations(x["target"], x["target_prediction"], logits=x["target_logits"])


def _tllib_kernel(source: Tensor, target: Tensor) -> Tensor:
    """Return tllib's five kernels: the mean distance is over all pairs, also of a frame with itself."""
    distances = squared_distances(torch.cat([source, target]))
    return multi_gaussian(distances, distances.detach().mean())


def _tllib_mmd(kernel: Tensor, n: int) -> Tensor:
    return mmd_of_kernel(kernel, n, unbiased=True) + 2 / (n - 1)


def _dan_as_tllib(x: Inputs) -> Tensor:
    return _tllib_mmd(_tllib_kernel(x["source"], x["target"]), len(x["source"]))


def _jan_as_tllib(x: Inputs) -> Tensor:
    distances = squared_distances(torch.cat([x["source_prediction"], x["target_prediction"]]))
    of_prediction = torch.exp(-distances / (2 * TLLIB_PREDICTION_SIGMA**2))
    return _tllib_mmd(_tllib_kernel(x["source"], x["target"]) * of_prediction, len(x["source"]))


def _coral_as_tllib(x: Inputs) -> Tensor:
    shift = (x["source"].mean(dim=0) - x["target"].mean(dim=0)).square().mean()
    return 4 * method_loss("coral")(x) + shift


def _adversarial(x: Inputs) -> Tensor:
    dann = DANN(DANN.Settings(), x["source"].shape[1], 1)
    dann.discriminator = _Discriminator(x["hidden"], x["output"])
    return dann.loss(*_activations(x), _step(REVERSAL)).value


class _Discriminator(torch.nn.Module):
    """One hidden layer whose weights are given, without biases."""

    def __init__(self, hidden: Tensor, output: Tensor) -> None:
        super().__init__()
        self.hidden, self.output = hidden, output

    def forward(self, features: Tensor) -> Tensor:
        return (torch.relu(features @ self.hidden) @ self.output)[:, None]


def _conditional_adversarial(x: Inputs) -> Tensor:
    features = torch.cat([x["source"], x["target"]])
    joint = multilinear_map(features, x["conditioning_logits"].softmax(dim=1))
    logits = reverse_gradient(joint, REVERSAL) @ x["conditional_output"]
    return domain_loss(*logits.split(len(x["source"])))


def _evidential(x: Inputs) -> Tensor:
    nu, alpha, beta = (x["evidence"] + torch.tensor([0.0, 1.0, 0.0]) + 1e-5).unbind(dim=2)
    return evidential_loss(x["source_force"], x["source_prediction"], Evidence(nu, alpha, beta))


def _subspace(x: Inputs) -> Tensor:
    weights = 1 + (x["head"][0] @ x["directions"]).abs()
    return subspace_loss(x["target"], x["mean"], x["directions"], x["variances"], weights)


def daregram_beside_its_cut(x: Inputs, extra: tuple[int, int] = (0, 0)) -> Tensor:
    """Return published DARE-GRAM with cuts between singular values: each domain keeps `extra` more than it should.

    As published, the cut lies on a singular value, and rounding decides whether `extra` is 0 or 1 in either domain. It
    was 0 in both, as in exact arithmetic, where public code was run.
    """
    settings = find_method("daregram-published").Settings()
    spectra = gram_spectra(x["source"], x["target"])
    rank = published_rank(*spectra, settings.threshold)
    cuts = []
    for values, more in zip(spectra, extra, strict=True):
        last_kept, first_dropped = values.detach()[rank + more - 1 : rank + more + 1]
        cuts.append((last_kept * first_dropped).sqrt() / values[0].detach())
    return daregram_cut_at(x["source"], x["target"], settings.angle, settings.scale, rank, *cuts)


COMPARISONS = (
    Comparison("dan", "DSAN's authors, DAN", "mmd", method_loss("dan")),
    Comparison("dan, as tllib", "tllib", "mmd-tllib", _dan_as_tllib),
    Comparison(
        "dan",
        "tllib",
        "mmd-tllib",
        method_loss("dan"),
        "V- for U-statistic + 2/(n−1); bandwidth over pairs of distinct frames",
    ),
    Comparison("jan, as tllib", "tllib", "jmmd-tllib", _jan_as_tllib),
    Comparison(
        "jan",
        "tllib",
        "jmmd-tllib",
        method_loss("jan"),
        "as dan; five kernels on the prediction for one of σ = 0.92",
    ),
    Comparison("dsan", "DSAN's authors", "lmmd", method_loss("dsan")),
    Comparison(
        "dsan-unmasked",
        "DSAN's authors",
        "lmmd",
        method_loss("dsan-unmasked"),
        "all classes of the source batch",
    ),
    Comparison("coral", "DeepDA", "coral", method_loss("coral")),
    Comparison("coral, as tllib", "tllib", "coral-tllib", _coral_as_tllib),
    Comparison(
        "coral",
        "tllib",
        "coral-tllib",
        method_loss("coral"),
        "a quarter of it, without its distance of the means",
    ),
    Comparison("dann", "tllib", "dann", _adversarial),
    Comparison("cdan, given class probabilities", "tllib", "cdan", _conditional_adversarial),
    Comparison(
        "rsd, as published", "RSD's authors", "rsd", lambda x: rsd_published(x["source"], x["target"])
    ),
    Comparison(
        "rsd",
        "RSD's authors",
        "rsd",
        method_loss("rsd"),
        "Σ sin²θ for Σ sin θ, a ridge, no mismatch of the bases",
    ),
    Comparison(
        "daregram-published, beside its cut", "DARE-GRAM's authors", "daregram", daregram_beside_its_cut
    ),
    Comparison(
        "daregram", "DARE-GRAM's authors", "daregram", method_loss("daregram"), "cut in a gap of the spectrum"
    ),
    Comparison(
        "daregram-tikhonov",
        "DARE-GRAM's authors",
        "daregram",
        method_loss("daregram-tikhonov"),
        "ridge for the cut",
    ),
    Comparison("cod, conditional part", "COD's authors", "cod", method_loss("cod", marginal=0.0)),
    Comparison("uga, evidential part", "UGA's authors", "uga", _evidential),
    Comparison("ssa", "SSA's authors", "ssa", _subspace),
)


def agreement(comparison: Comparison) -> Agreement:
    """Return how far a loss of ours is from public code."""
    arrays = published_arrays()
    values, gradients = zip(*(_differences(comparison, arrays, case) for case in CASES), strict=True)
    return Agreement(
        comparison.loss, comparison.public_code, max(values), max(gradients), comparison.deviation
    )


def inputs_of(arrays: dict[str, np.ndarray], case: int, published: str) -> Inputs:
    """Return the inputs of a case; those that the published loss has a gradient of require one."""
    prefix = f"{case}/input/"
    inputs = {
        name.removeprefix(prefix): torch.from_numpy(array)
        for name, array in arrays.items()
        if name.startswith(prefix)
    }
    for name in _with_gradient(arrays, case, published):
        inputs[name].requires_grad_(True)
    return inputs


def _with_gradient(arrays: dict[str, np.ndarray], case: int, published: str) -> list[str]:
    prefix = f"{case}/{published}/gradient/"
    return [name.removeprefix(prefix) for name in arrays if name.startswith(prefix)]


def _differences(comparison: Comparison, arrays: dict[str, np.ndarray], case: int) -> tuple[float, float]:
    x = inputs_of(arrays, case, comparison.published)
    value = comparison.ours(x)
    value.backward()
    entry = f"{case}/{comparison.published}"
    expected = float(arrays[f"{entry}/value"])
    gradients = []
    for name in _with_gradient(arrays, case, comparison.published):
        theirs = arrays[f"{entry}/gradient/{name}"]
        ours = np.zeros_like(theirs) if x[name].grad is None else x[name].grad.numpy()
        gradients.append(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs))
    return abs(float(value.detach()) - expected) / abs(expected), float(max(gradients))


def table(found: Sequence[Agreement]) -> ResultTable:
    """Return the table of losses against public code."""
    return ResultTable(
        "Losses against public code",
        ["loss", "public code", "value", "gradient", "deviation"],
        [
            [a.loss, a.public_code, f"{a.value:.0e}", f"{a.gradient:.0e}", a.deviation or "none"]
            for a in found
        ],
        "Largest relative difference over two batches, in float64.",
    )


def run(quick: bool, out_dir: Path) -> None:
    """Print the table and write `published-losses.json`.

    Raises
    ------
    RuntimeError
        If a loss without a named deviation differs from public code.
    """
    found = [agreement(comparison) for comparison in COMPARISONS]
    table(found).show()
    write_json(out_dir / "published-losses.json", found)
    wrong = [a.loss for a in found if not a.deviation and max(a.value, a.gradient) > TOLERANCE]
    if wrong:
        raise RuntimeError(f"{', '.join(wrong)} should equal public code and does not")
