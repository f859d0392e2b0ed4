"""A trained model: predicts forces or other labels, is saved and loaded, and takes the statistics of other pictures."""

import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from pydantic import FiniteFloat, PositiveInt, TypeAdapter
from torch import nn
from torch.optim.swa_utils import update_bn

from gelgap.adapt.data import Draw, generator, has_other_aspect, network_inputs
from gelgap.adapt.inputs import INPUTS, InputMap
from gelgap.adapt.network import (
    ForceNetwork,
    ResNet,
    load_checkpoint,
    load_imagenet_weights,
    make_network,
    save_checkpoint,
)
from gelgap.adapt.own_code import CodeNotLoaded, use_backbone
from gelgap.adapt.profile import Profile
from gelgap.assets.checksums import checksum_problem
from gelgap.assets.pinhole import Pinhole
from gelgap.data import ArrayFrames, LabelledFrames, Labels
from gelgap.data.frames.first_touch import STEP, TRAJECTORY
from gelgap.data.frames.labels import FORCE_COLUMNS

_FORMAT = 2
_INFERENCE_BATCH = 256
_STATISTICS_BATCH = 64


class AffineCorrection(NamedTuple):
    """A correction of each predicted label, F' = gain·F + offset, the offset in the label's unit."""

    gain: tuple[FiniteFloat, ...]
    offset: tuple[FiniteFloat, ...]

    def __call__(self, predicted: np.ndarray) -> np.ndarray:
        """Return corrected predictions (n, k)."""
        return np.multiply(predicted, self.gain) + self.offset

    def after(self, first: "AffineCorrection") -> "AffineCorrection":
        """Return the correction that applies `first`, then this one."""
        gain = np.multiply(self.gain, first.gain)
        offset = self(np.array(first.offset))
        return AffineCorrection(tuple(gain.tolist()), tuple(offset.tolist()))


@dataclass(frozen=True)
class ForceModel:
    """A network with what is needed to use it: `predict` maps pictures to labels, forces in newtons by default.

    labels are those it was trained on, with their ranges; size_px is the width and height of the pictures of the domain
    it is for, as stored, before they are reduced to the profile's; source, target and method say how it was trained;
    history holds the `EpochRecord` of every epoch of both stages as a dictionary. input_map is that of the domain it is
    for, where the profile's input has one; None where it is for several, and each data set is shown by a map of its
    own. correction is what a few labels added; camera took the pictures, where that is known.
    """

    network: ForceNetwork
    profile: Profile
    labels: Labels
    n_classes: int
    seed: int
    source: str
    size_px: tuple[int, int]
    target: str | None = None
    method: str = "source-only"
    history: tuple[dict[str, Any], ...] = field(default=())
    input_map: InputMap | None = None
    correction: AffineCorrection | None = None
    camera: Pinhole | None = None

    @property
    def device(self) -> torch.device:
        return self.network.device

    @property
    def force_range_n(self) -> np.ndarray:
        """The ranges of the labels (k, 2): of forces in N, (3, 2)."""
        return np.array(self.labels.ranges)

    @property
    def own_map(self) -> InputMap | None:
        """The input_map; a ValueError if the model is of several sources, each with a map of its own."""
        if self.input_map is None and INPUTS[self.profile.input].fit is not None:
            raise ValueError(
                f"{self.source} have a map each (input {self.profile.input}), your pictures none: adapt the model"
            )
        return self.input_map

    def corrected(self, correction: AffineCorrection) -> "ForceModel":
        """Return the model whose predictions are corrected so, after what corrects them now."""
        return replace(
            self, correction=correction if self.correction is None else correction.after(self.correction)
        )

    def features(self, frames: LabelledFrames) -> np.ndarray:
        """Return the transfer features (n, feature_dim) float32."""
        return self._infer(frames)[0]

    def predict(self, picture: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Return the labels (k,) of a picture (h, w, 3) uint8 RGB, or (n, k) of several (n, h, w, 3), each in its unit.

        A model of sequences, or of dents from first touch, takes several as one trajectory, in their order.

        The reference is the same sensor's picture without contact, (h, w, 3). Pictures have the aspect of those that
        the model was trained on and at least the size of the network's, to which they are reduced as in training.

        Raises
        ------
        ValueError
            If a picture has another shape or type, another size than the reference, another aspect, or is too small; if
            a single one is given to a model that needs trajectories;
            for the input `markers` if the reference shows no markers.
        """
        picture, reference = np.asarray(picture), np.asarray(reference)
        pictures = picture if picture.ndim == 4 else picture[None]
        for what, image in (("picture", pictures[:1]), ("reference", reference[None])):
            if image.dtype != np.uint8 or image.ndim != 4 or image.shape[3] != 3:
                raise ValueError(f"the {what} is {image.dtype} {image.shape[1:]}, not uint8 RGB (h, w, 3)")
        (height, width), (w0, h0) = pictures.shape[1:3], self.size_px
        if reference.shape[:2] != (height, width):
            raise ValueError(
                f"the picture is {width}×{height} px and the reference {reference.shape[1]}×{reference.shape[0]} px; "
                "both must be of one size, from the same camera"
            )
        if has_other_aspect((width, height), self.size_px):
            raise ValueError(
                f"the picture is {width}×{height} px; the model is for pictures of {w0}×{h0} px and would be shown a "
                "squeezed one: crop picture and reference to that aspect"
            )
        if picture.ndim == 3 and self.profile.needs_trajectories:
            raise ValueError(
                f"the model is shown trajectories (input {self.profile.input}, sequences of "
                f"{self.profile.sequence_length} pictures), not a single picture: give the pictures of one trajectory "
                "(n, h, w, 3) in their order"
            )
        columns: dict[str, Any] = {
            TRAJECTORY: np.zeros(len(pictures), int),
            STEP: np.arange(len(pictures)),
            self.labels.names[0]: np.full(len(pictures), np.nan),
        }
        frames = ArrayFrames("these pictures", pictures, reference, None, camera=self.camera, **columns)
        predicted = replace(self, input_map=self.own_map).predict_frames(frames)
        return predicted if picture.ndim == 4 else predicted[0]

    def predict_frames(self, frames: LabelledFrames) -> np.ndarray:
        """Return the predicted labels (n, k) of a data set's frames, each in its unit."""
        low, high = self.labels.low, self.labels.high
        predicted = low + self._infer(frames)[1].astype(float) * (high - low)
        return predicted if self.correction is None else self.correction(predicted)

    def predict_n(self, frames: LabelledFrames) -> np.ndarray:
        """Return the predicted forces (n, 3), N.

        Raises
        ------
        ValueError
            If the model predicts something else than all axes of the force.
        """
        if self.labels.names != FORCE_COLUMNS:
            raise ValueError(
                f"the model predicts {', '.join(self.labels.names)}, not Fx, Fy and Fz: use `predict_frames`"
            )
        return self.predict_frames(frames)

    @torch.inference_mode()
    def _infer(self, frames: LabelledFrames) -> tuple[np.ndarray, np.ndarray]:
        self.network.eval()
        pictures = network_inputs(frames, self.profile, self.device, self.input_map)
        features, predictions = [], []
        for rows in torch.arange(len(frames)).split(_INFERENCE_BATCH):
            batch = self.network.features(pictures.inputs(rows))
            features.append(batch.float().cpu().numpy())
            predictions.append(self.network.regressor(batch).float().cpu().numpy())
        return np.concatenate(features), np.concatenate(predictions)

    def save(self, path: str | Path) -> None:
        """Write the state dictionary and the description to one file."""
        content = {
            "format": _FORMAT,
            "state": self.network.state_dict(),
            "profile": self.profile.model_dump_json(),
            "labels": list(self.labels.names),
            "label_ranges": [list(bounds) for bounds in self.labels.ranges],
            "n_classes": self.n_classes,
            "seed": self.seed,
            "source": self.source,
            "size_px": self.size_px,
            "target": self.target,
            "method": self.method,
            "history": list(self.history),
            "input_map": TypeAdapter(InputMap | None).dump_python(self.input_map, mode="json"),
            "correction": TypeAdapter(AffineCorrection | None).dump_python(self.correction, mode="json"),
            "camera": None if self.camera is None else _geometry(self.camera.model_dump(mode="json")),
        }
        save_checkpoint(content, Path(path))

    @classmethod
    def load(cls, path: str | Path, backbone: str | None = None) -> "ForceModel":
        """Read a file that `save` wrote; of a model with a feature extractor of your own, name that (`use_backbone`).

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is not a gelgap checkpoint, is damaged, or the code of its feature extractor is not loaded, which a
            checkpoint never does itself.
        """
        named = backbone and use_backbone(backbone)
        path = Path(path)
        if problem := checksum_problem(path):
            raise ValueError(f"{path} {problem}; train it again or take a whole copy")
        content = load_checkpoint(path)
        if content.get("format") != _FORMAT:
            raise ValueError(f"{path} is not a gelgap checkpoint of format {_FORMAT}")
        try:
            model = cls._of(content)
        except CodeNotLoaded as error:
            raise ValueError(f"{path}: {error}") from None
        except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:200]
            raise ValueError(f"{path} is not a whole gelgap checkpoint ({reason})") from None
        if model.profile.input == "markers" and "camera" not in content:
            raise ValueError(f"{path} learned markers in pixels, which are now shown in mm; train it again")
        if named is not None and named.partition("#")[0] != model.profile.backbone.partition("#")[0]:
            raise ValueError(f"{path} has the backbone {model.profile.backbone}, not {backbone}: omit it")
        return model

    @classmethod
    def _of(cls, content: dict[str, Any]) -> "ForceModel":
        """Return the model that a checkpoint's content describes, or raise what says why it does not."""
        profile = Profile.model_validate_json(content["profile"])
        state, n_classes = content["state"], content["n_classes"]
        # Before a network of that size is made.
        if tuple(state["classifier.weight"].shape) != (n_classes, profile.feature_dim):
            raise ValueError(f"the classifier is {tuple(state['classifier.weight'].shape)}")
        labels = Labels.of(dict(zip(content["labels"], content["label_ranges"], strict=True)))
        network = make_network(profile, n_classes, seed=0, n_labels=len(labels))
        network.load_state_dict(state)
        TypeAdapter(tuple[PositiveInt, PositiveInt]).validate_python(content["size_px"])
        shown = TypeAdapter(InputMap | None).validate_python(content["input_map"])
        if shown is not None and {*map(len, shown)} != {profile.in_channels}:
            raise ValueError(f"input_map = {content['input_map']!r}")
        correction = TypeAdapter(AffineCorrection | None).validate_python(content["correction"])
        if correction is not None and {*map(len, correction)} != {len(labels)}:
            raise ValueError(f"correction = {content['correction']!r}")
        return cls(
            network,
            profile,
            labels,
            n_classes=n_classes,
            seed=content["seed"],
            source=content["source"],
            size_px=content["size_px"],
            target=content["target"],
            method=content["method"],
            history=tuple(content["history"]),
            input_map=shown,
            correction=correction,
            camera=TypeAdapter(Pinhole | None).validate_python(_geometry(content.get("camera"))),
        )


def _geometry(camera: dict[str, Any] | None) -> dict[str, Any] | None:
    """Return the geometry among a camera's fields: a checkpoint up to 0.3.0 has others, too."""
    return None if camera is None else {name: camera[name] for name in Pinhole.model_fields}


def load_start(network: ForceNetwork, path: Path, labels: tuple[str, ...], profile: Profile) -> None:
    """Start from a gelgap checkpoint, or load ImageNet weights into the backbone.

    Of a checkpoint with other labels or classes the outputs for those in common are taken; the others start anew.
    """
    if "state" not in load_checkpoint(path):
        if not isinstance(network.backbone, ResNet):
            raise ValueError(
                f"{path} is not a gelgap checkpoint: a feature extractor of your own loads other weights itself"
            )
        load_imagenet_weights(network.backbone, path)
        return
    checkpoint = ForceModel.load(path)
    state = checkpoint.network.state_dict()
    fresh = network.state_dict()
    if checkpoint.labels.names != labels:
        common = [name for name in labels if name in checkpoint.labels.names]
        to = [labels.index(name) for name in common]
        at = [checkpoint.labels.names.index(name) for name in common]
        for key in ("regressor.0.weight", "regressor.0.bias"):
            known, state[key] = state[key], fresh[key].clone()
            state[key][to] = known[at]
    if checkpoint.n_classes != network.classifier.out_features:
        state |= {key: fresh[key] for key in ("classifier.weight", "classifier.bias")}
    then = checkpoint.profile
    try:
        if INPUTS[profile.input].frozen and (then.pairing, INPUTS[then.input].fit) != (profile.pairing, None):
            raise RuntimeError("its backbone, which stays, has seen other inputs")
        network.load_state_dict(state)
    except RuntimeError as error:
        raise ValueError(
            f"checkpoint {path} was trained with another network ({then.backbone}, width {then.width:g}, "
            f"{then.pairing}, input {then.input}, sequence_length {then.sequence_length}); use the same profile"
        ) from error


def with_statistics_of(model: ForceModel, frames: LabelledFrames) -> ForceModel:
    """Return a copy of a model whose input and batch normalisations have the statistics of these frames' pictures."""
    network = copy.deepcopy(model.network)
    estimate_statistics(network, frames, model.profile, model.seed)
    shown = input_map(frames, model.profile, model.device)
    return replace(model, network=network, size_px=frames.size_px, input_map=shown, camera=frames.cameras[0])


def input_map(frames: LabelledFrames, profile: Profile, device: torch.device) -> InputMap | None:
    """Return the map of a domain's inputs; None where the profile's input has none, or each of several its own."""
    return None if INPUTS[profile.input].fit is None else network_inputs(frames, profile, device).map


def estimate_statistics(network: nn.Module, frames: LabelledFrames, profile: Profile, seed: int) -> None:
    """Set every batch normalisation's mean and variance to their averages over shuffled equal batches of all."""
    pictures = network_inputs(frames, profile, next(network.parameters()).device)
    shuffled = generator(seed, Draw.STATISTICS).permutation(len(pictures))
    batches = np.array_split(shuffled, 1 + (len(shuffled) - 1) // _STATISTICS_BATCH)
    update_bn(map(pictures.inputs, batches), network)
