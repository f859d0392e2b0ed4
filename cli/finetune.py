"""`gelgap finetune`: a checkpoint on a few labelled frames or clips of one's own."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gelgap import adapt
from gelgap.cli import options as opt


@dataclass(frozen=True)
class Finetune(opt.Command):
    """Fine-tune a checkpoint on a few labelled frames or clips, and say its error on others before and after.

    Labels that the data have and the network predicts are learnt, in the ranges of the network. All pictures of --on,
    labelled or not, adapt its normalisation.

    For example:
      gelgap finetune runs/stage1/mb0i0-*.pt --on data/wmb1i1 --test data/wmb1i1 --frames 8 --out tuned.pt
    """

    model: tyro.conf.Positional[Path]
    """A gelgap checkpoint, such as the pretrained.pt of `gelgap pretrain`."""
    on: Path
    """Folder of the data set of which some frames are learnt."""
    test: Path
    """Folder of the data set to evaluate on; if it is the same, the frames that are not learnt are held out."""
    frames: Annotated[int | None, opt.optional("K"), opt.between(1, 10_000_000)] = None
    """Number of frames to learn, spread over the commanded depths where these are known."""
    clips: Annotated[int | None, opt.optional("K"), opt.between(1, 10_000_000)] = None
    """Or number of clips to learn whole, told apart by the column `clip`."""
    seed: opt.Seed = 0
    """Seed of the draw and of the training."""
    out: Annotated[Path | None, opt.optional("PATH"), opt.OutputFile(".pt")] = None
    """Write the fine-tuned checkpoint here."""
    backbone: opt.OwnBackbone = None

    def run(self, started: float) -> None:
        """Fine-tune and print the errors."""
        if self.backbone is not None:
            adapt.use_backbone(self.backbone)
        tuned = adapt.finetune(
            self.model, self.on, self.test, frames=self.frames, clips=self.clips, seed=self.seed
        )
        print(tuned)
        if self.out is not None:
            tuned.model.save(self.out)
            print(f"wrote {self.out}")
