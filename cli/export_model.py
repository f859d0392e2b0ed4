"""`gelgap export-model`: a trained model as an ONNX file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gelgap import adapt
from gelgap.cli import options as opt


@dataclass(frozen=True)
class ExportModel(opt.Command):
    """Write a trained model as one ONNX file that takes picture and reference and gives labels in their units.

    For example:
      gelgap export-model tuned.pt -o tuned.onnx
    """

    model: tyro.conf.Positional[Path]
    """A gelgap checkpoint: the model.pt of a run, or what `gelgap finetune --out` wrote."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"]), opt.OutputFile(".onnx")]
    """The file to write; needs the extra `onnx`: pip install 'gelgap[onnx]'."""
    backbone: opt.OwnBackbone = None

    def run(self, started: float) -> None:
        """Export, compare the file with the model, and say how they agree."""
        model = adapt.ForceModel.load(self.model, self.backbone)
        difference = adapt.export_onnx(model, self.out)
        width, height = model.profile.image_size_px
        units = zip(model.labels.names, model.labels.quantities, strict=True)
        labels = ", ".join(f"{name} in {unit}" for name, (_, unit) in units)
        print(f"wrote {self.out}: picture and reference of {width}×{height} px (uint8 RGB) to {labels}")
        print(f"onnxruntime gives the model's labels to {difference:.1g} of their range")
