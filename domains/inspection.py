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
from gelgap.domains.opening import open_domain
from gelgap.domains.picture_damages import header_damages, table_damages
from gelgap.domains.stored import PictureFiles


@dataclass(frozen=True)
class DomainSummary:
    """The facts of one domain: `frames` that can be read, the declared range of forces and the extremes found."""

    folder: str
    name: str
    frames: int
    unconverged: int
    size_px: tuple[int, int]
    points: int
    classes: int
    force_range_n: tuple[tuple[float, float], ...]
    force_min_n: tuple[float, ...]
    force_max_n: tuple[float, ...]
    outside_range: int
    optional_columns: tuple[str, ...]
    bytes: int
    notes: tuple[str, ...]

    def __str__(self) -> str:
        forces = ", ".join(
            f"F{axis} {low:.3f}…{high:.3f}"
            for axis, low, high in zip("xyz", self.force_min_n, self.force_max_n, strict=True)
        )
        lines = [
            f"{self.name} ({self.folder})",
            f"  frames   {self.frames} of {self.size_px[0]}×{self.size_px[1]} px, {self.bytes / 1e6:.1f} MB; "
            f"{self.unconverged} left out (not converged)",
            f"  contacts {self.points} points, {self.classes} classes",
            f"  forces   {forces} N; {self.outside_range} frames outside the declared range",
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
    low, high = frames.force_range_n.T
    forces = frames.force_n[np.isfinite(frames.force_n).all(axis=1)]
    return DomainSummary(
        folder=str(folder),
        name=frames.name,
        frames=len(frames),
        unconverged=frames.unconverged,
        size_px=frames.size_px,
        points=_distinct(frames.point_id),
        classes=_distinct(frames.contact_class),
        force_range_n=tuple(tuple(axis) for axis in frames.force_range_n.tolist()),
        force_min_n=tuple(forces.min(axis=0).tolist()) if len(forces) else (0.0,) * 3,
        force_max_n=tuple(forces.max(axis=0).tolist()) if len(forces) else (0.0,) * 3,
        outside_range=int(((frames.force_n < low) | (frames.force_n > high)).any(axis=1).sum()),
        optional_columns=frames.optional_columns if isinstance(frames, GeneratedDomain) else (),
        bytes=sum(path.stat().st_size for path in Path(folder).rglob("*") if _is_data(path)),
        notes=(*frames.notes, *_label_notes(frames), *_picture_notes(frames)),
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


def _label_notes(frames: LabelledFrames) -> list[str]:
    notes = []
    if not np.isfinite(frames.force_n).all():
        notes.append(
            f"{int((~np.isfinite(frames.force_n)).any(axis=1).sum())} frames have a force that is not a number"
        )
    pulling = int((frames.force_n[:, 2] > 0).sum())
    if pulling:
        notes.append(f"{pulling} frames have Fz > 0: the sensor is pulled, or the sign is another one")
    return notes
