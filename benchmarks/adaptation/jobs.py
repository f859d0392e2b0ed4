"""A training run: what it is, where it finds its data, and the record that it leaves."""

import hashlib
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gelgap.benchmarks.adaptation.board import recipes_of

if TYPE_CHECKING:
    from gelgap.adapt import Profile
    from gelgap.domains import DomainRecipe, GeneratedDomain, GenerationReport

Axes = tuple[float, float, float]
Changes = tuple[tuple[str, Any], ...]
RUNS = "runs.jsonl"
BY_POINT: Changes = (("split_by", "point"),)
AT_RANDOM: Changes = (("split_by", "random"),)
_NAN = (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class TrainingJob:
    """One run to do: a method on a group of a data set with a seed.

    `changes` are profile fields that differ from the preset, `settings` the method's own.
    """

    source: str
    target: str
    method: str
    seed: int
    data: str = "paired"
    changes: Changes = ()
    settings: Changes = ()

    @property
    def group(self) -> tuple[str, str]:
        """Source and target."""
        return self.source, self.target

    @property
    def design(self) -> str:
        """Whether contacts are paired or independent."""
        return self.data.removeprefix("tune-")

    def profile(self, preset: str) -> "Profile":
        """Return the preset with this job's changes; of the methods' settings its own alone."""
        from gelgap.adapt import Profile

        profile = Profile.preset(preset)
        own = {**profile.settings.get(self.method, {}), **dict(self.settings)}
        return profile.replace(**dict(self.changes), settings={self.method: own} if own else {})

    def method_settings(self, preset: str) -> dict[str, Any]:
        """Return the method's own settings that differ from its defaults, those of the preset among them."""
        return self.profile(preset).settings.get(self.method, {})

    def __str__(self) -> str:
        """Return what it is in a line of text."""
        differs = "".join(f"  {name} = {value}" for name, value in (*self.changes, *self.settings))
        return f"{self.data}  {self.source} → {self.target}  {self.method}  seed {self.seed}{differs}"


@dataclass(frozen=True)
class RunRecord:
    """One finished run: errors on the target's test frames per axis (N, and R²), and what else the tables need.

    A run that stopped with `problem` (its features collapsed, or its losses were not finite) counts with the errors of
    the source's mean force. `configuration` is a hash of all that methods have in common: profile and recipes of
    both domains. `settings` are the method's own, `control` is the method that it must beat. `stage1_s` is 0 where
    another run had trained the checkpoint. Candidates of a choice have the selectors' `scores`, and the `alarm` of a
    constant predictor.
    """

    job: TrainingJob
    profile: str
    configuration: str = ""
    versions: str = ""
    settings: dict[str, Any] = field(default_factory=dict)
    control: str | None = None
    problem: str | None = None
    mae_n: Axes = _NAN
    r2: Axes = _NAN
    constant_mean_n: Axes = _NAN
    source_held_out_r2: Axes | None = None
    stage1_s: float = 0.0
    stage2_s: float = math.nan
    skipped_steps: int = 0
    diagnostics: dict[str, float] = field(default_factory=dict)
    scores: dict[str, float] | None = None
    alarm: bool = False

    @property
    def mean_mae_n(self) -> float:
        """Mean over the axes, N."""
        return float(np.mean(self.mae_n))

    @property
    def is_sound(self) -> bool:
        """Whether the run ended, and a selector sees no constant predictor."""
        return self.problem is None and not self.alarm


@dataclass(frozen=True)
class Bench:
    """Where runs find their data and leave their records, with which profile, and how much time they may take now.

    Without `seeds` or `methods` a part of the benchmark takes its own. `workers` are processes, by default one per
    core; one means this process, without a cluster. No run is begun after `stop`, a time of `time.time`.
    """

    data: Path
    out: Path
    profile: str
    seeds: tuple[int, ...] | None = None
    workers: int | None = None
    stop: float = math.inf
    methods: tuple[str, ...] | None = None

    @classmethod
    def at(cls, folder: Path, **limits: Any) -> "Bench":
        """Return the bench of a folder that is named after the profile, its data beside it."""
        return cls(folder.parent / f"data-{folder.name}", folder, folder.name, **limits)

    def within(self, name: str, profile: str) -> "Bench":
        """Return a bench for another profile with data of its own, below this one's records."""
        folder = self.out / name
        return replace(self, data=folder / "data", out=folder / "runs", profile=profile)

    @property
    def is_quick(self) -> bool:
        """Whether one small group is enough, to see everything run."""
        return self.profile == "smoke"

    def generate(self, recipes: "Sequence[DomainRecipe]", data: str = "paired") -> "GenerationReport":
        """Generate what is missing of some domains of a data set."""
        from gelgap.domains import generate_recipes

        scheduler = "synchronous" if self.workers == 1 else None
        report = generate_recipes(recipes, self.data / data, scheduler=scheduler, workers=self.workers)
        print(report, flush=True)
        return report

    def generate_set(self, data: str) -> None:
        """Generate what is missing of one of the benchmark's data sets."""
        self.generate(recipes_of(data), data)

    def is_over(self) -> bool:
        """Return whether no further run is to be begun."""
        return time.time() >= self.stop


def open_pair(bench: Bench, job: TrainingJob) -> "tuple[GeneratedDomain, GeneratedDomain]":
    """Return the source and the target of a job."""
    from gelgap.domains import open_domain

    source, target = (open_domain(bench.data / job.data / name) for name in job.group)
    return source, target


def configuration_of(bench: Bench, job: TrainingJob) -> str:
    """Return a hash of all that the methods of a job's group have in common: profile and recipes of both domains."""
    return configuration_hash(
        job.profile(bench.profile), *(domain.recipe.key for domain in open_pair(bench, job))
    )


def configuration_hash(profile: "Profile", *data: Any) -> str:
    """Return a hash of a profile without methods' settings, and of what says which data are used."""
    from gelgap.assets.checksums import canonical_json

    common = profile.model_dump(mode="json", exclude={"name", "settings"}, exclude_defaults=True)
    return hashlib.sha256(canonical_json([common, *data])).hexdigest()[:12]
