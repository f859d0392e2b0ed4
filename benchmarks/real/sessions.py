"""Force from one session's light to another's: grasps of the same objects with a GelSight Wedge, both ways.

Errors are those of held-out clips of the target. An interval is the bootstrap's over clips and seeds; pictures of a
clip are never drawn one by one, because neighbours are nearly equal.
"""

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
import pandas as pd

from gelgap.benchmarks.adaptation.study import Study
from gelgap.benchmarks.common import Results, bootstrap, mean_of, show, write_json
from gelgap.benchmarks.real.published_sets import LAYOUTS, WEDGE_CLONE
from gelgap.domains import convert
from gelgap.domains.formats.convert import CONTACT_N, TABLE
from gelgap.domains.formats.pictures import decode_picture, resized
from gelgap.domains.frames.folders import read_table

if TYPE_CHECKING:
    from gelgap.domains import LabelledFrames

LOG = logging.getLogger(__name__)
CLONE = "EstimateModulus"
SESSIONS = ("2023-12-06", "2023-12-16")
"""The two sessions with objects in common."""
FZ_RANGE_N = (-30.0, 0.0)
"""By which both sessions' forces are normalised; stated beforehand, so that no label of the target moves it."""
FOLDS = 3
SEEDS = (0, 1, 2, 3, 4)
_SIZE_PX = (80, 60)

Session = pd.DataFrame
"""The pictures in contact of one session, which has one light, numbered from 0: `session`, `clip`, `object`, `fz_n`,
and `change`, the mean absolute difference of a picture from its clip's reference, in grey levels."""


class Fold(NamedTuple):
    """What a method may train on, and the target's clips that it is tested on: parts of sessions, or their frames.

    The target's training clips come without labels unless a method says that it uses them.
    """

    source_train: Any
    target_train: Any
    target_test: Any


def converted_sessions(data: Path, out_dir: Path) -> Path:
    """Return the folder of all sessions of the clone in the folder `data`, converted once and kept in `out_dir`.

    Raises
    ------
    FileNotFoundError
        If the clone is missing; the message has the line that gets it.
    ValueError
        If the clone lacks one of the sessions that are compared.
    """
    clone, converted = data / CLONE, out_dir / "real" / "wedge"
    if not clone.is_dir():
        raise FileNotFoundError(f"{clone} is missing; get it: {WEDGE_CLONE} {clone}")
    if not converted.is_dir():
        LOG.info("converting %s, once", clone)
        convert(clone, LAYOUTS["wedge"], converted)
    if missing := [name for name in SESSIONS if not (converted / name).is_dir()]:
        there = sorted(path.name for path in converted.iterdir() if path.is_dir())
        raise ValueError(f"{clone} has no session {missing[0]}; it has {', '.join(there)}")
    return converted


@cache
def read_sessions(folder: Path) -> dict[str, Session]:
    """Return the two sessions that are compared, of the objects that both have.

    Raises
    ------
    ValueError
        If they have no object in common.
    """
    both = {name: _read(folder / name) for name in SESSIONS}
    shared = set.intersection(*(set(session["object"]) for session in both.values()))
    if not shared:
        raise ValueError(f"the sessions {' and '.join(SESSIONS)} of {folder} have no object in common")
    return {name: session[session["object"].isin(shared)] for name, session in both.items()}


def _read(folder: Path) -> Session:
    rows = pd.DataFrame(read_table(folder / TABLE)).astype({"fz_n": float})
    rows = rows[-rows["fz_n"] > CONTACT_N].reset_index(drop=True)
    references = {name: _small(folder / name) for name in rows["reference"].unique()}
    change = [
        np.abs(_small(folder / picture) - references[reference]).mean()
        for picture, reference in zip(rows["picture"], rows["reference"], strict=True)
    ]
    return rows[["session", "clip", "object", "fz_n"]].assign(session=folder.name, change=change)


def _small(path: Path) -> np.ndarray:
    return resized(decode_picture(path.read_bytes()), _SIZE_PX).astype(float)


def key_of_session(session: Session) -> list[Any]:
    """Return what a training on a session depends on: its name, and the clip and the force of each picture."""
    return [session["session"].iloc[0], session["clip"].tolist(), session["fz_n"].tolist()]


def frames_of_session(folder: Path, session: Session) -> "LabelledFrames":
    """Return pictures of a session, whose folder of all sessions is given, with Fz as their only label."""
    return _in_contact(folder / session["session"].iloc[0]).take(session.index.to_numpy())


@cache
def _in_contact(folder: Path) -> "LabelledFrames":
    from gelgap.domains import Labels, open_domain, with_labels

    frames = open_domain(folder)
    pressed = frames.take(np.flatnonzero(-frames.columns["fz_n"] > CONTACT_N))
    return with_labels(pressed, Labels.of({"fz_n": FZ_RANGE_N}))


class SessionStudy(Study):
    """Runs on real sessions; the data are the folder of all converted ones."""

    @classmethod
    def of(cls, quick: bool, out_dir: Path, data: Path, kind: str = "") -> Self:
        """Return the study of the cpu profile, or quickly of the smoke profile in this process."""
        profile = "smoke" if quick else "cpu"
        out = out_dir / "real" / f"{kind}{profile}"
        return cls(converted_sessions(data, out_dir), out, profile, workers=1 if quick else None)

    @staticmethod
    def describe(record: Results) -> str:
        """Return why a run stopped, or else its mean error over the tested clips."""
        return record["problem"] or f"{np.mean(list(record['clip_mae_n'].values())):.3f} N"


def clip_folds(source: Session, target: Session, seed: int) -> Iterator[Fold]:
    """Yield the folds of a seed, which deals the clips of each object anew; the source's are dealt too.

    Each clip is tested in one fold of a seed. Those of an object go round the folds, in random order from a random one.
    """
    dealt = []
    for place, session in enumerate((source, target)):
        rng, folds = np.random.default_rng((seed, place)), {}
        for _, own in session.groupby("object"):
            clips = rng.permutation(sorted(own["clip"].unique()))
            start = int(rng.integers(FOLDS))
            folds |= {str(clip): (start + turn) % FOLDS for turn, clip in enumerate(clips)}
        dealt.append(session["clip"].map(folds))
    for number in range(FOLDS):
        left_out, tested = (folds == number for folds in dealt)
        yield Fold(source[~left_out], target[~tested], target[tested])


def clip_means(errors: np.ndarray, clips: Sequence[str]) -> dict[str, float]:
    """Return the mean absolute error of pictures on each of their clips, to five digits after the point."""
    return pd.Series(np.abs(errors)).groupby(np.asarray(clips), sort=False).mean().round(5).to_dict()


def errors_by_clip(predicted: np.ndarray, tested: "LabelledFrames") -> dict[str, float]:
    """Return the MAE on each clip, N, of predictions (n, 1) of Fz, or of one for all."""
    return clip_means((predicted - tested.label_values)[:, 0], tested.columns["clip"].astype(str))


def clip_table(records: pd.DataFrame, results: str, columns: str) -> pd.DataFrame:
    """Return what `clip_means` found in runs, by clip (rows) and seed or draw; NaN where no run tested a clip."""
    found = records.filter(regex=f"^{results}[.]").rename(columns=lambda name: name.partition(".")[2])
    return found.groupby(records[columns]).first().T.sort_index()


def compare(
    statistic: Callable[[np.ndarray, np.ndarray], float],
    own: np.ndarray,
    other: np.ndarray,
    *,
    is_paired: bool,
    resamples: int,
) -> tuple[float, tuple[float, float]]:
    """Return a statistic of two tables of errors (…, clips, seeds) and its 95 % bootstrap interval.

    Clips and seeds are drawn with replacement, the same for all methods of a table, because methods share what makes a
    clip hard; paired tables are drawn alike.
    """
    rng, drawn = np.random.default_rng(0), []
    for _ in range(resamples):
        cells = _draw(rng, own)
        drawn.append(statistic(own[..., *cells], other[..., *(cells if is_paired else _draw(rng, other))]))
    low, high = np.nanpercentile(drawn, [2.5, 97.5])
    return statistic(own, other), (float(low), float(high))


def _draw(rng: np.random.Generator, errors: np.ndarray) -> tuple[np.ndarray, ...]:
    return np.ix_(*(rng.integers(count, size=count) for count in errors.shape[-2:]))


def fitted_fz_n(
    fold: Fold, labels_of: str = "source", degree: int = 2, standardise: bool = False
) -> np.ndarray:
    """Return Fz (n,) in N of a fold's test pictures, by a polynomial in how much a picture differs from rest.

    Standardised, each domain's change has the mean 0 and the deviation 1 of its own training pictures.
    """
    labelled = fold.source_train if labels_of == "source" else fold.target_train
    change, tested = labelled["change"], fold.target_test["change"]
    if standardise:
        of_domains = (change, labelled["change"]), (tested, fold.target_train["change"])
        change, tested = ((values - own.mean()) / own.std(ddof=0) for values, own in of_domains)
    fitted = np.polynomial.Polynomial.fit(change.to_numpy(), labelled["fz_n"].to_numpy(), degree)
    return fitted(tested.to_numpy())


PLAIN_METHODS: tuple[tuple[str, str, Callable[[Fold], np.ndarray]], ...] = (
    ("constant mean", "source", partial(fitted_fz_n, degree=0)),
    ("quadratic in the mean difference", "source", fitted_fz_n),
    ("the same, standardised per domain", "source", partial(fitted_fz_n, standardise=True)),
    ("quadratic in the mean difference", "target", partial(fitted_fz_n, labels_of="target")),
)
"""Methods without a network: name, whose labels they take, and how they predict."""


def plain_errors(
    predict: Callable[[Fold], np.ndarray], folds: Mapping[int, Sequence[Fold]]
) -> tuple[pd.DataFrame, float]:
    """Return a method's MAE of Fz, N, on each tested clip (rows) with each seed's folds, and the time of a fold, ms."""
    found, seconds = {}, 0.0
    for seed, own in folds.items():
        errors_n = []
        for fold in own:
            started = time.process_time()
            predicted_n = predict(fold)
            seconds += time.process_time() - started
            tested = fold.target_test
            errors_n.append((tested["fz_n"] - predicted_n).abs().groupby(tested["clip"]).mean())
        found[seed] = pd.concat(errors_n)
    return pd.DataFrame(found).sort_index(), 1e3 * seconds / sum(map(len, folds.values()))


def run(quick: bool, out_dir: Path, data: Path) -> None:
    """Measure both ways, print the table, and write `real-sessions.json` to `out_dir`."""
    seeds = SEEDS[:1] if quick else SEEDS
    both = read_sessions(converted_sessions(data, out_dir))
    rows, found = [], []
    for source, target in (SESSIONS, SESSIONS[::-1]):
        folds = {seed: list(clip_folds(both[source], both[target], seed)) for seed in seeds}
        for method, labels, predict in PLAIN_METHODS:
            errors_n, ms = plain_errors(predict, folds)
            mae_n = errors_n.to_numpy()
            of = {"source": source, "target": target, "method": method, "labels": labels}
            found.append({**of, "clips": list(errors_n.index), "mae_n": mae_n, "ms_per_fold": ms})
            rows.append([f"{source} → {target}", method, labels, float(mean_of(mae_n)), bootstrap(mae_n), ms])
    amounts = [f"{len(own)} pictures of {own['clip'].nunique()} clips" for own in both.values()]
    show(
        "Force from one session to another, on real grasps: MAE of Fz on held-out target clips",
        pd.DataFrame(
            rows, columns=["source → target", "method", "labels of", "MAE, N", "95 % interval", "ms a fold"]
        ),
        f"GelSight Wedge, {', '.join(sorted(set(both[SESSIONS[0]]['object'])))}: {' and '.join(amounts)}. "
        f"Mean of clips; {FOLDS} folds by clip, {len(seeds)} seed(s), every seed with every fold.",
        {"": "{:.2f}", "ms a fold": "{:.1f}"},
    )
    write_json(out_dir / "real-sessions.json", found)
