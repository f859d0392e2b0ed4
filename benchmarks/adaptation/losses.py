"""Adaptation losses under stress: value, gradient and run time in every trap, ours beside the published
forms."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common.tables import print_table, write_json

BATCH = 32
FEATURES = 256
OUTLIER = 1e4
REPEATS = 20


@dataclass(frozen=True)
class Case:
    """One pair of batches. `distance_is_zero` lists the losses whose right value here is 0; force and
    classes go along."""

    name: str
    source: object
    target: object
    zero_for: tuple[str, ...] = ()
    common_classes: bool = True


@dataclass(frozen=True)
class Outcome:
    """What a loss did: its value, gradient norm, relative error against float64, and the verdict in a
    word."""

    loss: str
    case: str
    value: float
    gradient: float
    error: float
    verdict: str


def rsd_published(source, target):
    """RSD as published (Chen et al. 2021): singular vectors, Σ sin θ and the basis mismatch; for
    comparison."""
    import torch

    u_s, _, _ = torch.linalg.svd(source.T, full_matrices=False)
    u_t, _, _ = torch.linalg.svd(target.T, full_matrices=False)
    p_s, cosines, p_t = torch.linalg.svd(u_s.T @ u_t)
    sines = torch.sqrt(1 - cosines.square())
    return sines.abs().sum() + 0.01 * torch.linalg.matrix_norm(p_s.abs() - p_t.T.abs())


def losses() -> dict[str, Callable]:
    """Return the losses as functions of (source features, target features, whether classes are shared)."""
    import torch

    from gelgap.adapt.kernels import bandwidth, multi_gaussian, squared_distances
    from gelgap.adapt.methods.cod import conditional_discrepancy
    from gelgap.adapt.methods.coral import coral
    from gelgap.adapt.methods.dan import mk_mmd
    from gelgap.adapt.methods.dann import DANN, domain_loss
    from gelgap.adapt.methods.daregram import daregram, daregram_published, daregram_tikhonov
    from gelgap.adapt.methods.dsan import lmmd
    from gelgap.adapt.methods.jan import joint_mmd
    from gelgap.adapt.methods.rsd import projection_distance

    def with_classes(s, t, common, robust=False):
        w_s, w_t = torch.zeros(len(s), 361), torch.zeros(len(t), 361)
        w_s[torch.arange(len(s)), torch.arange(len(s)) % 20] = 1
        w_t[torch.arange(len(t)), torch.arange(len(t)) % 20 + (0 if common else 100)] = 1
        return lmmd(s, t, w_s.to(s), w_t.to(t), robust)

    def conditional(s, t, common):
        force = torch.from_numpy(np.random.default_rng(3).random((len(s) + len(t), 3)))
        distances = squared_distances(torch.cat([s, t]))
        kernel = multi_gaussian(distances, bandwidth(distances, robust=False))
        return conditional_discrepancy(kernel, force[: len(s)], force[len(s) :], 0.1, 0.01)

    def adversarial(s, t, common):
        discriminator = DANN(DANN.Settings(), s.shape[1], n_classes=1).discriminator.to(s.dtype)
        logits = discriminator(torch.cat([s, t]))[:, 0]
        return domain_loss(logits[: len(s)], logits[len(s) :])

    return {
        "dann": adversarial,
        "coral": lambda s, t, common: coral(s, t),
        "dan": lambda s, t, common: mk_mmd(s, t),
        "dan, median": lambda s, t, common: mk_mmd(s, t, robust=True),
        "jan": lambda s, t, common: joint_mmd((s, s[:, :3]), (t, t[:, :3])),
        "dsan (lmmd)": with_classes,
        "dsan, median": lambda s, t, common: with_classes(s, t, common, robust=True),
        "cod": conditional,
        "rsd": lambda s, t, common: projection_distance(s, t),
        "rsd published": lambda s, t, common: rsd_published(s, t),
        "daregram": lambda s, t, common: daregram(s, t, 0.5, 0.003, 0.9),
        "daregram published": lambda s, t, common: daregram_published(s, t, 0.5, 0.003, 0.9),
        "daregram-tikhonov": lambda s, t, common: daregram_tikhonov(s, t, 0.5, 0.003, 0.01),
    }


def cases() -> list[Case]:
    """Return every trap, float32."""
    import torch

    generator = torch.Generator().manual_seed(0)
    s = torch.rand(BATCH, FEATURES, generator=generator)
    t = torch.rand(BATCH, FEATURES, generator=generator) * 1.3
    outlier = t.clone()
    outlier[0] = OUTLIER
    duplicated = s[: BATCH // 2].repeat(2, 1)
    wide = torch.rand(2 * FEATURES, FEATURES, generator=generator)
    # The discriminator's loss is ln 2 where it cannot tell the domains apart, never 0.
    everything = tuple(name for name in losses() if name != "dann")
    not_conditional = tuple(name for name in everything if name != "cod")
    unpaired = tuple(name for name in everything if name not in ("dsan (lmmd)", "dsan, median", "cod"))
    # A constant batch has no covariance; its multiple spans the same line.
    constant = ("coral", "rsd", "rsd published")
    return [
        Case("random", s, t),
        Case("identical", s, s.clone(), zero_for=not_conditional),
        Case("permuted rows", s, s.flip(0), zero_for=unpaired),
        Case("constant", torch.ones_like(s), 2 * torch.ones_like(s), zero_for=constant),
        Case("all zero", torch.zeros_like(s), torch.zeros_like(s), zero_for=not_conditional),
        Case("duplicated rows", duplicated, t),
        Case("repeated singular values", torch.eye(BATCH, FEATURES), torch.eye(BATCH, FEATURES).roll(9, 1)),
        Case("batch > dimension", wide, 1.3 * wide.flip(1)),
        Case("dead units", s * (torch.arange(FEATURES) > 99), t * (torch.arange(FEATURES) > 49)),
        Case("one outlier at 1e4", s, outlier),
        Case("offset 1e4", s + OUTLIER, t + OUTLIER),
        Case("no common class", s, t, zero_for=("dsan (lmmd)", "dsan, median"), common_classes=False),
        Case("unequal batches", s, t[:13]),
        Case("scale 1e-6", 1e-6 * s, 1e-6 * t),
        Case("scale 1e6", 1e6 * s, 1e6 * t),
        Case("bfloat16 features", s.bfloat16().float(), t.bfloat16().float()),
    ]


def stress(name: str, loss: Callable, case: Case) -> Outcome:
    """Evaluate one loss in one trap, in float32 and against itself in float64."""
    import torch

    source = case.source.clone().requires_grad_(True)
    try:
        value = loss(source, case.target, case.common_classes)
        value.backward()
        exact = float(loss(case.source.double(), case.target.double(), case.common_classes).detach())
    except ValueError as error:
        return Outcome(name, case.name, math.nan, math.nan, math.nan, f"error: {str(error).split(':')[0]}")
    except RuntimeError:
        return Outcome(name, case.name, math.nan, math.nan, math.nan, "CRASH")
    value, gradient = float(value.detach()), float(torch.linalg.vector_norm(source.grad.double()))
    error = abs(value - exact) / max(abs(exact), 1e-3)
    if not math.isfinite(value):
        verdict = "VALUE NOT FINITE"
    elif not math.isfinite(gradient):
        verdict = "GRADIENT NOT FINITE"
    elif name in case.zero_for:
        verdict = "zero, right" if abs(value) < 1e-4 else "NOT ZERO"
    elif value == 0:
        verdict = "SILENT ZERO"
    elif error > 1e-2:
        verdict = "INEXACT"
    else:
        verdict = "ok"
    return Outcome(name, case.name, value, gradient, error, verdict)


KERNEL_LOSSES = ("dan", "dan, median", "jan", "dsan (lmmd)", "dsan, median", "cod")


def gradient_error(loss: Callable) -> float:
    """Return the largest relative error of the gradient along random directions, against central
    differences in float64; kernels hold their bandwidth fixed in the gradient, so that they differ from it
    by design."""
    import torch

    generator = torch.Generator().manual_seed(1)
    s = torch.rand(8, 24, generator=generator, dtype=torch.float64).requires_grad_(True)
    t = 1.3 * torch.rand(8, 24, generator=generator, dtype=torch.float64)
    loss(s, t, True).backward()
    worst = 0.0
    for _ in range(5):
        direction = torch.randn(8, 24, generator=generator, dtype=torch.float64)
        step = 1e-6
        with torch.no_grad():
            rise = float(loss(s + step * direction, t, True) - loss(s - step * direction, t, True)) / (
                2 * step
            )
        slope = float((s.grad * direction).sum())
        worst = max(worst, abs(rise - slope) / max(abs(rise), 1e-9))
    return worst


def milliseconds(loss: Callable, case: Case, repeats: int) -> float:
    """Return the median time of value and gradient, ms."""
    times = []
    for _ in range(repeats):
        source = case.source.clone().requires_grad_(True)
        start = time.perf_counter()
        loss(source, case.target, True).backward()
        times.append(1e3 * (time.perf_counter() - start))
    return float(np.median(times))


def run(quick: bool, out_dir: Path) -> None:
    """Print the verdict of every loss in every trap, and the cost of each loss; write JSON to `out_dir`."""
    import torch

    torch.set_num_threads(1)
    torch.manual_seed(0)
    every_loss, every_case = losses(), cases()
    outcomes = [stress(name, loss, case) for name, loss in every_loss.items() for case in every_case]
    found = {(outcome.loss, outcome.case): outcome for outcome in outcomes}
    for names in (list(every_loss)[:7], list(every_loss)[7:]):
        print_table(
            "Losses in their traps" if names[0] == "dann" else "",
            ["trap", *names],
            [[case.name, *(found[name, case.name].verdict for name in names)] for case in every_case],
        )
    costs = {
        name: (
            milliseconds(loss, every_case[0], 3 if quick else REPEATS),
            None if name in KERNEL_LOSSES else gradient_error(loss),
        )
        for name, loss in every_loss.items()
    }
    print_table(
        f"Cost of value and gradient, batch {BATCH}, {FEATURES} features, one thread",
        ["loss", "ms", "float32 error", "gradient error"],
        [[name, ms, found[name, "random"].error, error] for name, (ms, error) in costs.items()],
        note="gradient error: against central differences; not for kernels, whose bandwidth carries no gradient",
    )
    ours = [o for o in outcomes if "published" not in o.loss]
    bad = [o for o in ours if o.verdict.isupper()]
    print(
        f"{len(ours)} cases of our losses: {len(bad)} failed"
        + "".join(f"; {o.loss} in {o.case}" for o in bad)
    )
    write_json(out_dir / "stability-losses.json", {"outcomes": outcomes, "costs": costs})
