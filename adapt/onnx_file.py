"""A trained model as one ONNX file: pictures in, labels in their units out, whatever lies between."""

import copy
import json
import warnings
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from gelgap.adapt.inputs import INPUTS
from gelgap.adapt.model import ForceModel
from gelgap.assets.extras import need_extra
from gelgap.assets.whole_file import whole_file
from gelgap.data.frames.paired_frames import PairedFrames

# Of a label's range. A network whose course depends on the picture itself is not what was traced.
_MOST_DIFFERENCE = 1e-4
_OPSET = 18


class PictureToLabels(nn.Module):
    """All that `ForceModel.predict` does after pictures were reduced to the network's size.

    Pictures (n, h, w, 3) and the reference (1, h, w, 3) or one for each (n, h, w, 3), uint8 RGB, become a tensor (n,)
    for each label, in its unit.
    """

    def __init__(self, model: ForceModel) -> None:
        super().__init__()
        self.network = copy.deepcopy(model.network).cpu()
        self.pairing = model.profile.pairing
        self.map = model.own_map
        low, high = model.labels.low, model.labels.high
        gain, offset = model.correction or (np.ones(len(low)), np.zeros(len(low)))
        scale = np.multiply(gain, high - low)
        start = np.multiply(gain, low) + offset
        self.scale, self.start = (torch.tensor(values, dtype=torch.float32) for values in (scale, start))

    def forward(self, picture: Tensor, reference: Tensor) -> tuple[Tensor, ...]:
        shown = PairedFrames.pair(picture, reference, self.pairing)
        shown = shown if self.map is None else self.map(shown)
        return (self.start + self.scale * self.network(shown)).unbind(1)


def export_onnx(model: ForceModel, path: str | Path) -> float:
    """Write a model as an ONNX file, and return the largest difference to the model itself, as a share of a range.

    Inputs are `picture` and `reference`, uint8 RGB (n, h, w, 3) of the network's size; outputs are the labels by name,
    float32 (n,), each in its unit. The file's metadata has units, ranges, sizes, and how the model was trained.

    Raises
    ------
    ValueError
        If the package onnx or onnxruntime is missing, the input is `markers` or `touch`, pictures are levelled, or the
        file computes something else than the model.
    """
    need_extra("export to ONNX", "onnx", "onnx", "onnxruntime")
    if INPUTS[model.profile.input].find is not None:
        raise ValueError(
            f"input {model.profile.input}: what it shows is found outside the network, which ONNX cannot hold; export "
            "a model of another input"
        )
    if model.profile.levelling:
        raise ValueError(
            "levelling: pictures are brought to their reference's light outside the network, which ONNX cannot hold; "
            "export a model that was trained without"
        )
    if model.profile.sequence_length > 1:
        raise ValueError(
            f"sequence_length = {model.profile.sequence_length}: the ONNX file holds networks of single pictures; "
            "export a model with sequence_length = 1"
        )
    import onnx

    (width, height), names = model.profile.image_size_px, model.labels.names
    whole = PictureToLabels(model).eval()
    # From dark to bright, so that pictures are darker than their reference in the trace and brighter after it.
    brightest = np.array([50, 100, 150, 200, 250]).reshape(5, 1, 1, 1)
    noise = np.random.default_rng(0).uniform(0, brightest, (5, height, width, 3))
    pictures = torch.from_numpy(noise.astype(np.uint8))
    inputs = pictures[:2], pictures[4:]
    axes = {name: {0: "n"} for name in ("picture", *names)} | {"reference": {0: "one or n"}}
    with whole_file(Path(path)) as temporary, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about tracing, whose result is compared below
        # The exporter that follows TorchScript; the other one needs the package onnxscript.
        torch.onnx.export(
            whole,
            inputs,
            str(temporary),
            input_names=["picture", "reference"],
            output_names=list(names),
            dynamic_axes=axes,
            opset_version=_OPSET,
            dynamo=False,
        )
        file = onnx.load(str(temporary))
        onnx.helper.set_model_props(file, _metadata(model))
        onnx.save(file, str(temporary))
        difference = _difference(whole, temporary, pictures)
        if not difference <= _MOST_DIFFERENCE:
            raise ValueError(
                f"the ONNX file computes labels that differ by {difference:.2g} of their range from the model's: the "
                f"course of backbone {model.profile.backbone} depends on the picture, which ONNX cannot follow"
            )
    return difference


def _metadata(model: ForceModel) -> dict[str, str]:
    labels, (width, height) = model.labels, model.profile.image_size_px
    described = {
        "gelgap": version("gelgap"),
        "labels": list(labels.names),
        "units": [unit for _, unit in labels.quantities],
        "ranges": labels.ranges,
        "width_px": width,
        "height_px": height,
        "trained_on_px": model.size_px,
        "pairing": model.profile.pairing,
        "input": model.profile.input,
        "source": model.source,
        "target": model.target,
        "method": model.method,
    }
    return {name: x if isinstance(x, str) else json.dumps(x) for name, x in described.items()}


@torch.inference_mode()
def _difference(whole: PictureToLabels, path: Path, pictures: Tensor) -> float:
    """Return the largest difference of a file's labels for some pictures, as a share of the label's range."""
    import onnxruntime

    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    inputs = pictures, pictures.flip(0)
    given = dict(zip(("picture", "reference"), (image.numpy() for image in inputs), strict=True))
    predicted = np.stack(session.run(None, given))
    expected = torch.stack(whole(*inputs)).numpy()
    return float((np.abs(predicted - expected) / whole.scale.abs().numpy()[:, None]).max())
