"""A trained force model: predicts newtons, is saved and loaded."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from gelgap.adapt.batches import network_inputs
from gelgap.adapt.checkpoint import load_checkpoint
from gelgap.adapt.network import ForceNetwork, make_network
from gelgap.adapt.profile import Profile
from gelgap.assets.checksums import checksum_problem
from gelgap.assets.whole_file import whole_file
from gelgap.domains import ChannelStatistics, LabelledFrames

_FORMAT = 1
_INFERENCE_BATCH = 256


class AffineCorrection(NamedTuple):
    """A correction of each axis of predicted forces, F' = gain·F + offset_n."""

    gain: tuple[float, float, float]
    offset_n: tuple[float, float, float]

    def __call__(self, force_n: np.ndarray) -> np.ndarray:
        """Return corrected forces (n, 3), N."""
        return np.multiply(force_n, self.gain) + self.offset_n

    def after(self, first: "AffineCorrection") -> "AffineCorrection":
        """Return the correction that applies `first`, then this one."""
        gain, offset_n = np.multiply(self.gain, first.gain), self(np.array(first.offset_n))
        return AffineCorrection(tuple(gain.tolist()), tuple(offset_n.tolist()))


@dataclass(frozen=True)
class ForceModel:
    """A network with what is needed to use it: `predict_n` maps frames to forces in newtons.

    force_range_n (3, 2) is the source's declared range; source, target and method say how it was trained;
    history holds the `EpochRecord` of every epoch of both stages as a dictionary. input_statistics are those of the
    domain it is for, where the profile standardises the input; correction is what a few labels added.
    """

    network: ForceNetwork
    profile: Profile
    force_range_n: np.ndarray
    n_classes: int
    seed: int
    source: str
    target: str | None = None
    method: str = "source-only"
    history: tuple[dict[str, Any], ...] = field(default=())
    input_statistics: ChannelStatistics | None = None
    correction: AffineCorrection | None = None

    @property
    def device(self) -> torch.device:
        return next(self.network.parameters()).device

    def features(self, frames: LabelledFrames) -> np.ndarray:
        """Return the transfer features (n, feature_dim) float32."""
        return self._infer(frames)[0]

    def predict_n(self, frames: LabelledFrames) -> np.ndarray:
        """Return the predicted forces (n, 3), N."""
        low, high = np.asarray(self.force_range_n, float).T
        force_n = low + self._infer(frames)[1].astype(float) * (high - low)
        return force_n if self.correction is None else self.correction(force_n)

    @torch.inference_mode()
    def _infer(self, frames: LabelledFrames) -> tuple[np.ndarray, np.ndarray]:
        self.network.eval()
        pictures = network_inputs(frames, self.profile, self.device, self.input_statistics)
        features, predictions = [], []
        for start in range(0, len(frames), _INFERENCE_BATCH):
            rows = np.arange(start, min(start + _INFERENCE_BATCH, len(frames)))
            batch = self.network.features(pictures.inputs(rows))
            features.append(batch.float().cpu().numpy())
            predictions.append(self.network.regressor(batch).float().cpu().numpy())
        if not features:
            return np.empty((0, self.profile.feature_dim), np.float32), np.empty((0, 3), np.float32)
        return np.concatenate(features), np.concatenate(predictions)

    def save(self, path: str | Path) -> None:
        """Write the state dictionary and the description to one file."""
        content = {
            "format": _FORMAT,
            "state": self.network.state_dict(),
            "profile": self.profile.model_dump_json(),
            "force_range_n": np.asarray(self.force_range_n, float).tolist(),
            "n_classes": self.n_classes,
            "seed": self.seed,
            "source": self.source,
            "target": self.target,
            "method": self.method,
            "history": list(self.history),
            "input_statistics": self.input_statistics and [list(values) for values in self.input_statistics],
            "correction": self.correction and [list(values) for values in self.correction],
        }
        with whole_file(Path(path)) as temporary, temporary.open("wb") as file:
            torch.save(content, file)

    @classmethod
    def load(cls, path: str | Path) -> "ForceModel":
        """Read a file that `save` wrote.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not a gelgap checkpoint, or is damaged.
        """
        path = Path(path)
        if problem := checksum_problem(path):
            raise ValueError(f"{path} {problem}; train it again or take a whole copy")
        content = load_checkpoint(path)
        if content.get("format") != _FORMAT:
            raise ValueError(f"{path} is not a gelgap checkpoint of format {_FORMAT}")
        try:
            return cls(**_fields(content))
        except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise ValueError(f"{path} is not a whole gelgap checkpoint ({reason})") from None


def _fields(content: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of the model that a checkpoint's content describes, or raise what says why it does not."""
    profile = Profile.model_validate_json(content["profile"])
    state, n_classes = content["state"], content["n_classes"]
    # Before a network of that size is made.
    if tuple(state["classifier.weight"].shape) != (n_classes, profile.feature_dim):
        raise ValueError(f"the classifier is {tuple(state['classifier.weight'].shape)}")
    force_range_n = np.array(content["force_range_n"], dtype=float)
    if force_range_n.shape != (3, 2) or not (np.diff(force_range_n) > 0).all():
        raise ValueError(f"force_range_n = {content['force_range_n']!r}")
    network = make_network(profile, n_classes, seed=0)
    network.load_state_dict(state)
    return {
        "network": network,
        "profile": profile,
        "force_range_n": force_range_n,
        "n_classes": n_classes,
        "seed": content["seed"],
        "source": content["source"],
        "target": content["target"],
        "method": content["method"],
        "history": tuple(content["history"]),
        "input_statistics": _statistics(content.get("input_statistics"), profile),
        "correction": _correction(content.get("correction")),
    }


def _statistics(content: list[list[float]] | None, profile: Profile) -> ChannelStatistics | None:
    if content is None:
        return None
    mean, std = _two_rows("input_statistics", content, profile.in_channels)
    if min(std) <= 0:
        raise ValueError(f"input_statistics = {content!r}")
    return ChannelStatistics(mean, std)


def _correction(content: list[list[float]] | None) -> AffineCorrection | None:
    return None if content is None else AffineCorrection(*_two_rows("correction", content, 3))


def _two_rows(name: str, content: list[list[float]], columns: int) -> tuple[tuple[float, ...], ...]:
    values = np.array(content, dtype=float)
    if values.shape != (2, columns) or not np.isfinite(values).all():
        raise ValueError(f"{name} = {content!r}")
    return tuple(tuple(row) for row in values.tolist())
