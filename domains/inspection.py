"""What a data set holds: counts, ranges, what is unusual, and whether its files are intact."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gelgap.domains.contacts import paired_contacts
from gelgap.domains.dataset import LabelledFrames
from gelgap.domains.domain_gaps import domain_gap
from gelgap.domains.folder import MANIFEST, Damage, DomainFolder
from gelgap.domains.generated import GeneratedDomain
from gelgap.domains.label_notes import label_notes, outside
from gelgap.domains.labels import FORCE_COLUMNS, QUANTITIES, Labels, Range, known_labels, usual_labels
from gelgap.domains.opening import open_domain
from gelgap.domains.picture_damages import header_damages, table_damages
from gelgap.domains.picture_folder import GROUPS
from gelgap.domains.stored import PictureFiles


@dataclass(frozen=True)
class LabelFacts:
    """A label's name, its range, and the extremes found (0 where no frame has a number)."""

    name: str
    range: Range
    smallest: float
    largest: float

    def __str__(self) -> str:
        return f"{QUANTITIES[self.name].symbol} {self.smallest:.3f}…{self.largest:.3f}"


@dataclass(frozen=True)
class DomainSummary:
    """The facts of one domain: `frames` that can be read, and its labels with their ranges and extremes.

    A generated domain's labels are its forces; `outside_range` counts frames with a label outside its range.
    """

    folder: str
    name: str
    frames: int
    unconverged: int
    size_px: tuple[int, int]
    points: int
    classes: int
    groups: tuple[tuple[str, int], ...]
    labels: tuple[LabelFacts, ...]
    outside_range: int
    optional_columns: tuple[str, ...]
    bytes: int
    notes: tuple[str, ...]

    @property
    def force_min_n(self) -> tuple[float, ...]:
        """The lowest force along each axis that there is, N."""
        return tuple(facts.smallest for facts in self.labels if facts.name in FORCE_COLUMNS)

    @property
    def force_max_n(self) -> tuple[float, ...]:
        """The highest force along each axis that there is, N."""
        return tuple(facts.largest for facts in self.labels if facts.name in FORCE_COLUMNS)

    def __str__(self) -> str:
        forces = [facts for facts in self.labels if facts.name in FORCE_COLUMNS]
        others = [f"{facts} {QUANTITIES[facts.name].unit}" for facts in self.labels if facts not in forces]
        outside_range = f"; {self.outside_range} frames outside the declared range"
        told = [f"  forces   {', '.join(map(str, forces))} N{outside_range}"] if forces else []
        told += [f"  labels   {', '.join(others)}{'' if forces else outside_range}"] if others else []
        told += (
            [f"  groups   {', '.join(f'{count} of {name}' for name, count in self.groups)}"]
            if self.groups
            else []
        )
        lines = [
            f"{self.name} ({self.folder})",
            f"  frames   {self.frames} of {self.size_px[0]}×{self.size_px[1]} px, {self.bytes / 1e6:.1f} MB; "
            f"{self.unconverged} left out (not converged)",
            f"  contacts {self.points} points, {self.classes} classes",
            *told,
            f"  columns  {', '.join(self.optional_columns) or 'none beyond the standard ones'}",
        ]
        return "\n".join([*lines, *(f"  note     {note}" for note in self.notes)])


def domain_folders(folder: Path | str) -> tuple[Path, ...]:
    """Return the domain folders at a path: itself, or those directly inside.

    Raises
    ------
    FileNotFoundError
        If the path does not exist.
    """
    folder = Path(folder)
    if not folder.exists():
        raise FileNotFoundError(f"{folder} does not exist; expected the folder of one or several domains")
    inside = sorted(path.parent for path in folder.glob(f"*/{MANIFEST}"))
    return tuple(inside) or (folder,)


def inspect_domain(folder: Path | str) -> DomainSummary:
    """Return the facts of one domain.

    Raises
    ------
    FileNotFoundError, RuntimeError
        As `open_domain`.
    """
    frames = open_domain(folder)
    known = (
        usual_labels(frames.columns) if isinstance(frames, GeneratedDomain) else known_labels(frames.columns)
    )
    facts = tuple(_facts(frames, name) for name in known)
    return DomainSummary(
        folder=str(folder),
        name=frames.name,
        frames=len(frames),
        unconverged=frames.unconverged,
        size_px=frames.size_px,
        points=_distinct(frames.point_id),
        classes=_distinct(frames.contact_class),
        groups=tuple((name, len(set(frames.columns[name]))) for name in GROUPS if name in frames.columns),
        labels=facts,
        outside_range=int(outside(frames, Labels.of({label.name: label.range for label in facts})).sum()),
        optional_columns=frames.optional_columns if isinstance(frames, GeneratedDomain) else (),
        bytes=sum(path.stat().st_size for path in Path(folder).rglob("*") if _is_data(path)),
        notes=(*frames.notes, *label_notes(frames), *_picture_notes(frames)),
    )


def verify_domain(folder: Path | str) -> tuple[Damage, ...]:
    """Return what is wrong with the files of a data set; empty if all is intact.

    Every byte of a generated domain is compared with its manifest, and what every picture states of itself with the
    reference. Of pictures with a table every picture is decoded, and every force must be a number.

    Raises
    ------
    FileNotFoundError
        If it is not a data set of a known layout.
    """
    if DomainFolder(folder).exists() or not Path(folder).is_dir():
        return tuple(DomainFolder(folder).damages()) or _vouched_damages(folder)
    frames = open_domain(folder)
    return tuple(table_damages(frames)) if isinstance(frames, PictureFiles) else ()


def _vouched_damages(folder: Path | str) -> tuple[Damage, ...]:
    """Return what no reader takes of a domain whose bytes are those that its manifest states."""
    try:
        found = [str(damage) for damage in header_damages(GeneratedDomain(folder))]
    except (RuntimeError, ValueError) as error:
        found = [str(error).partition(": run the same")[0]]
    return tuple(Damage(MANIFEST, f"vouches for what cannot be used: {problem}") for problem in found)


def gap_rows(frames: LabelledFrames, base: LabelledFrames) -> list[tuple[str, str]]:
    """Return (what, value) of the gap from `base`: colours, and, where known, modulus, markers and forces.

    Raises
    ------
    ValueError
        If their pictures have different sizes.
    """
    from gelgap.render import picture_gap

    seen = picture_gap(base.reference, frames.reference)
    rows = [("reference pictures, CIEDE2000", _colours(seen.mean, seen.percentile_95))]
    if isinstance(frames, GeneratedDomain) and isinstance(base, GeneratedDomain):
        gap = domain_gap(base.recipe, frames.recipe)
        rows += [
            (
                "the same without markers and noise",
                _colours(gap.colour_difference, gap.colour_difference_p95),
            ),
            ("modulus", f"× {gap.modulus_ratio:.4g}"),
            ("markers", gap.markers),
            ("fields that differ", _in_short(gap.fields)),
        ]
        mine, theirs = paired_contacts(frames, base)
        if len(mine):
            change = np.abs(frames.force_n[mine] - base.force_n[theirs]).mean(axis=0)
            text = ", ".join(f"F{axis} {value:.4f}" for axis, value in zip("xyz", change, strict=True))
            rows.append((f"mean force difference of {len(mine)} paired contacts, N", text))
    return rows


def _facts(frames: LabelledFrames, name: str) -> LabelFacts:
    values = frames.columns[name][np.isfinite(frames.columns[name])]
    extremes = (float(values.min()) + 0.0, float(values.max()) + 0.0) if len(values) else (0.0, 0.0)
    return LabelFacts(name, frames.label_range(name), *extremes)


def _colours(mean: float, percentile_95: float) -> str:
    return f"mean {mean:.2f}, 95th percentile {percentile_95:.2f}"


def _in_short(fields: tuple[str, ...]) -> str:
    counts = Counter(field.split(".")[0] for field in fields)
    return ", ".join(f"{name} ({count})" if count > 1 else name for name, count in counts.items()) or "none"


def _is_data(path: Path) -> bool:
    return path.is_file() and ".cache" not in path.parts


def _distinct(numbers: np.ndarray) -> int:
    return len(np.unique(numbers[numbers >= 0]))


def _picture_notes(frames: LabelledFrames) -> list[str]:
    """Return what pictures say of themselves that is wrong; generated ones were compared with their manifest."""
    if not isinstance(frames, PictureFiles):
        return []
    damages = header_damages(frames)
    if not damages:
        return []
    return [f"{len(damages)} pictures cannot be used, see --verify; first: {damages[0]}"]
