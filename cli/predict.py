"""`gelgap predict`: labels of pictures, of files or of a camera, by a trained model."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gelgap import adapt
from gelgap.assets.whole_file import whole_file
from gelgap.cli import options as opt

_WIDTH = 10


@dataclass(frozen=True)
class Predict(opt.Command):
    """Predict force, or whatever a model was trained to predict, for pictures of files or of a camera.

    Each picture is a row. Its note says where a prediction is at the end of the range that the model was trained in.

    For example:
      gelgap predict tuned.pt pressed.png harder.png --reference rest.png
      gelgap predict tuned.pt own/mine/press-1 --reference own/mine/press-1/reference.png --out forces.csv
      gelgap predict tuned.pt --camera 0 --reference rest.png
    """

    model: tyro.conf.Positional[Path]
    """A gelgap checkpoint: the model.pt of a run, or what `gelgap finetune --out` wrote."""
    reference: Path
    """The same sensor's picture without contact, of the same size."""
    pictures: Annotated[tyro.conf.Positional[tuple[Path, ...]], opt.optional("[PICTURE ...]")] = ()
    """Pictures (PNG, JPEG, BMP or TIFF), or folders of them."""
    camera: Annotated[int | None, opt.optional("INDEX"), opt.between(0, 99)] = None
    """In place of files, predict each picture of this camera until Ctrl-C."""
    out: Annotated[Path | None, opt.optional("PATH"), opt.OutputFile(".csv")] = None
    """Write the rows to this CSV file, too, with the labels' names (fz_n: Fz in N) as the header."""
    backbone: opt.OwnBackbone = None

    def run(self, started: float) -> None:
        """Predict, print a table, and write it if asked."""
        if (self.camera is None) == (not self.pictures):
            raise ValueError("name a model, and after it pictures or folders, or a camera (--camera 0)")
        import pandas as pd

        from gelgap.assets.image_file import read_image

        model = adapt.ForceModel.load(self.model, self.backbone)
        reference = read_image(self.reference)
        rows: list[dict[str, object]] = []
        if self.camera is None:
            rows += adapt.predict_each(model, adapt.read_pictures(self.pictures), reference)
            print(_text(rows))
        else:
            with suppress(KeyboardInterrupt):
                for row in adapt.predict_each(model, adapt.camera_pictures(self.camera), reference):
                    print(_text([row], header=not rows), flush=True)
                    rows.append(row)
        if self.out is not None:
            with whole_file(self.out) as temporary:
                pd.DataFrame(rows).to_csv(temporary, index=False, float_format="%.6g")
            print(f"wrote {self.out}")


def _text(rows: list[dict[str, object]], header: bool = True) -> str:
    """Return rows with symbols and units above them; rows that are printed one by one stand below each other."""
    import pandas as pd

    from gelgap.data.frames.labels import QUANTITIES

    units = {name: str(quantity) for name, quantity in QUANTITIES.items()}
    table = pd.DataFrame(rows).rename(columns=units)
    return table.to_string(index=False, header=header, float_format="%.4f", col_space=_WIDTH, justify="right")
