"""Keys of runs and of the stage 1 that they share: hashes of everything that decides their result."""

import hashlib
import json
from pathlib import Path

from gelgap.adapt.methods.registry import method_code
from gelgap.adapt.profile import Profile
from gelgap.adapt.splits import SplitFrames
from gelgap.assets.checksums import file_sha256
from gelgap.domains import LabelledFrames

_METHODS_VERSION = 2
"""Raised whenever the same method, profile and seed give another result than before."""
_STAGE_2_FIELDS = frozenset(
    name
    for name in Profile.model_fields
    if name.startswith(("adapt_", "transfer_", "classification_"))
    or name in ("batch_statistics", "regression_weight", "settings")
)


def run_key(
    frames: SplitFrames, method: str, profile: Profile, seed: int, weights: str | Path | None = None
) -> str:
    """Return the key of a run: frames, method, hyperparameters, seed and starting weights.

    Settings of other methods do not change it, nor fields at their default: a profile may gain a field.
    """
    parts = (frames.source_train, frames.source_held_out, frames.target_train, frames.target_test)
    own = {name: values for name, values in profile.settings.items() if name == method}
    code = method_code(method)
    return _key(
        parts, method if code is None else f"{method} {code}", profile.replace(settings=own), seed, weights
    )


def stage1_key(
    source_train: LabelledFrames, profile: Profile, seed: int, weights: str | Path | None = None
) -> str:
    """Return the key of a stage 1; runs that only differ in stage 2 share it."""
    return _key((source_train,), "stage1", stage1_profile(profile), seed, weights)


def stage1_profile(profile: Profile) -> Profile:
    """Return the profile with all that stage 1 does not depend on at its default."""
    fields = Profile.model_fields
    return profile.replace(
        **{name: fields[name].get_default(call_default_factory=True) for name in _STAGE_2_FIELDS}
    )


def _key(
    parts: tuple[LabelledFrames, ...], method: str, profile: Profile, seed: int, weights: str | Path | None
) -> str:
    content = {
        "frames": [[frames.name, frames.digest, len(frames)] for frames in parts],
        "method": method,
        "methods_version": _METHODS_VERSION,
        "profile": profile.model_dump(mode="json", exclude={"name"}, exclude_defaults=True),
        "seed": seed,
        "weights": None if weights is None else _weights_digest(Path(weights)),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _weights_digest(path: Path) -> str:
    if not path.is_file():
        raise FileNotFoundError(f"weights file {path} does not exist")
    return file_sha256(path)
