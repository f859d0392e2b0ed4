"""Force from one session's light to another's: grasps of the same objects with a GelSight Wedge, both ways.

Errors are those of held-out clips of the target. An interval is the bootstrap's over clips and seeds; pictures of a
clip are never drawn one by one, because neighbours are nearly equal.
"""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelgap.benchmarks.common import bootstrap as bootstrap_interval
from gelgap.benchmarks.common.tables import print_table, write_json
from gelgap.benchmarks.real.clip_folds import FOLDS, SEEDS, clip_folds
from gelgap.benchmarks.real.plain_methods import PLAIN_METHODS, ForceMethod
from gelgap.benchmarks.real.sessions import Session, converted_sessions, read_sessions


@dataclass(frozen=True)
class Transfer:
    """A method's error in one direction: `mae_n` (clips, seeds) of Fz on clips that it has not seen, N."""

    source: str
    target: str
    method: str
    labels: str
    clips: tuple[str, ...]
    mae_n: np.ndarray
    ms_per_fold: float

    @property
    def interval_n(self) -> tuple[float, float]:
        """The 95 % interval of the mean, N."""
        return bootstrap_interval(self.mae_n)


def measure(source: Session, target: Session, method: ForceMethod, seeds: tuple[int, ...]) -> Transfer:
    """Test a method on each clip of the target once per seed."""
    clips = tuple(np.unique(target.clip).tolist())
    mae_n = np.full((len(clips), len(seeds)), np.nan)
    started = time.process_time()
    for column, seed in enumerate(seeds):
        for fold in clip_folds(source, target, seed):
            error_n = np.abs(method.predict(fold) - fold.test.fz_n)
            for clip in np.unique(fold.test.clip):
                mae_n[clips.index(clip), column] = error_n[fold.test.clip == clip].mean()
    ms = 1e3 * (time.process_time() - started) / (len(seeds) * FOLDS)
    return Transfer(source.name, target.name, method.name, method.labels, clips, mae_n, ms)


def run(quick: bool, out_dir: Path, data: Path) -> None:
    """Measure both ways, print the table, and write `real-sessions.json` to `out_dir`."""
    seeds = SEEDS[:1] if quick else SEEDS
    both = read_sessions(converted_sessions(data, out_dir))
    found = [
        measure(source, target, method, seeds)
        for source, target in (both, both[::-1])
        for method in PLAIN_METHODS
    ]
    print_table(
        "Force from one session to another, on real grasps: MAE of Fz on held-out target clips",
        ("source → target", "method", "labels of", "MAE, N", "95 % interval", "ms a fold"),
        [
            (
                f"{one.source} → {one.target}",
                one.method,
                one.labels,
                f"{np.nanmean(one.mae_n):.2f}",
                "{:.2f}…{:.2f}".format(*one.interval_n),
                f"{one.ms_per_fold:.1f}",
            )
            for one in found
        ],
        f"GelSight Wedge, {', '.join(np.unique(both[0].object))}: "
        f"{' and '.join(f'{len(session.fz_n)} pictures of {len(np.unique(session.clip))} clips' for session in both)}. "
        f"Mean of clips; {FOLDS} folds by clip, {len(seeds)} seed(s), every seed with every fold.",
    )
    write_json(out_dir / "real-sessions.json", found)
