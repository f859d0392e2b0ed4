"""Labelled tactile pictures of one domain as plain arrays, and how they are split."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from gelgap.adapt.profile import Profile

PAPER_FORCE_RANGE_N = ((-0.75, 0.75), (-0.75, 0.75), (-3.0, 0.0))
"""The paper's fixed ranges of Fx, Fy, Fz, N, used for min-max normalisation."""


@dataclass(frozen=True)
class Frames:
    """n labelled frames of one domain, all in memory.

    images (n, h, w, 3) uint8; reference (h, w, 3) uint8, the picture without contact; force_n (n, 3) N;
    contact_class (n,) int, 0 for the reference pose, −1 unknown; point_id (n,) int; force_range_n (3, 2) N,
    the declared range; n_classes, how many contact classes the label may take; native_size_px (w, h), the
    size on disk before the pictures were resized; digest, a hash of
    the data set on disk.
    """

    name: str
    images: np.ndarray
    reference: np.ndarray
    force_n: np.ndarray
    contact_class: np.ndarray
    point_id: np.ndarray
    force_range_n: np.ndarray = field(default_factory=lambda: np.array(PAPER_FORCE_RANGE_N))
    n_classes: int = 361
    native_size_px: tuple[int, int] | None = None
    digest: str = ""

    def __post_init__(self) -> None:
        n = len(self.images)
        if self.images.ndim != 4 or self.images.shape[3] != 3 or self.images.dtype != np.uint8:
            raise ValueError(
                f"domain {self.name}: images must be uint8 (n, h, w, 3), not {self.images.dtype} "
                f"{self.images.shape}"
            )
        if self.reference.shape != self.images.shape[1:]:
            raise ValueError(
                f"domain {self.name}: the reference picture is {self.reference.shape}, the images are "
                f"{self.images.shape[1:]}; they must have one size"
            )
        for name, expected in (("force_n", (n, 3)), ("contact_class", (n,)), ("point_id", (n,))):
            if getattr(self, name).shape != expected:
                raise ValueError(
                    f"domain {self.name}: {name} has shape {getattr(self, name).shape}; "
                    f"{n} images need {expected}"
                )
        if np.shape(self.force_range_n) != (3, 2) or not (np.diff(self.force_range_n) > 0).all():
            raise ValueError(f"domain {self.name}: force_range_n must be (3, 2) with lower < upper bounds")

    def __len__(self) -> int:
        return len(self.images)

    def take(self, indices: np.ndarray) -> "Frames":
        """Return the frames with these indices, in this order."""
        return replace(
            self,
            images=self.images[indices],
            force_n=self.force_n[indices],
            contact_class=self.contact_class[indices],
            point_id=self.point_id[indices],
        )

    def check_labels(self) -> None:
        """Raise a ValueError if a label lies outside the declared force range or is no contact class."""
        low, high = np.asarray(self.force_range_n, float).T
        outside = ~((self.force_n >= low) & (self.force_n <= high))
        if outside.any():
            frame, axis = np.argwhere(outside)[0]
            raise ValueError(
                f"domain {self.name}: {outside.any(axis=1).sum()} of {len(self)} frames have a force outside "
                f"the declared range; first: frame {frame}, F{'xyz'[axis]} = "
                f"{self.force_n[frame, axis]:.4g} N, allowed [{low[axis]:g}, {high[axis]:g}] N; "
                f"labels are never clipped"
            )
        if len(self) and not (self.contact_class.min() >= -1 and self.contact_class.max() < self.n_classes):
            raise ValueError(
                f"domain {self.name}: contact_class spans {self.contact_class.min()}…"
                f"{self.contact_class.max()}, allowed 0…{self.n_classes - 1} (−1: unknown)"
            )

    @property
    def has_classes(self) -> bool:
        """Whether every frame has a contact class."""
        return bool((self.contact_class >= 0).all())


def load_frames(folder: str | Path, profile: Profile, n_classes: int = 361) -> Frames:
    """Read a generated domain at the profile's picture size."""
    from gelgap.domains import open_domain

    data = open_domain(folder)
    return Frames(
        name=data.name,
        images=np.array(data.images(profile.image_size_px)),
        reference=data.reference_at(profile.image_size_px),
        force_n=np.asarray(data.force_n, np.float32),
        contact_class=np.asarray(data.contact_class, np.int64),
        point_id=np.asarray(data.point_id, np.int64),
        force_range_n=np.asarray(data.force_range_n, float),
        n_classes=n_classes,
        native_size_px=data.size_px,
        digest=data.digest,
    )


def check_same_size(source: Frames, target: Frames) -> None:
    """Raise a ValueError if the pictures of the two domains differ in size, on disk or as loaded."""
    sizes = [(f.native_size_px or f.images.shape[2:0:-1], f.images.shape[2:0:-1]) for f in (source, target)]
    if sizes[0] != sizes[1]:
        raise ValueError(
            f"source {source.name} has {sizes[0][0][0]}×{sizes[0][0][1]} px pictures, target {target.name} "
            f"has {sizes[1][0][0]}×{sizes[1][0][1]} px; both domains must have one picture size"
        )


def split_indices(
    frames: Frames, shares: tuple[float, ...], by: Literal["random", "point"], seed: int
) -> tuple[np.ndarray, ...]:
    """Return one sorted index array per share, disjoint and complete; `by="point"` never divides a contact
    point.

    Raises
    ------
    ValueError
        If a positive share would be empty.
    """
    rng = np.random.default_rng(np.random.SeedSequence([seed, len(shares)]))
    groups = np.arange(len(frames)) if by == "random" else frames.point_id
    order = rng.permutation(np.unique(groups))
    ends = np.round(np.cumsum(shares) / np.sum(shares) * len(order)).astype(int)
    parts = tuple(np.flatnonzero(np.isin(groups, members)) for members in np.split(order, ends[:-1]))
    for share, part in zip(shares, parts, strict=True):
        if share > 0 and len(part) == 0:
            raise ValueError(
                f"domain {frames.name}: {len(order)} {'frames' if by == 'random' else 'contact points'} are "
                f"too few for shares {shares}; generate more or split otherwise"
            )
    return parts


def split_source(frames: Frames, profile: Profile, seed: int) -> tuple[Frames, Frames]:
    """Return the source's training frames and its held-out frames (none if the profile holds none out)."""
    train, held_out = split_indices(
        frames, (1 - profile.source_holdout, profile.source_holdout), profile.split_by, seed
    )
    return frames.take(train), frames.take(held_out)


def split_target(frames: Frames, profile: Profile, seed: int) -> tuple[Frames, Frames, Frames]:
    """Return the target's training (unlabelled), validation and test frames."""
    parts = split_indices(frames, profile.target_split, profile.split_by, seed)
    return frames.take(parts[0]), frames.take(parts[1]), frames.take(parts[2])
