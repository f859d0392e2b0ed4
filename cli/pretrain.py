"""`gelgap pretrain`: drawn domains, and a network trained on all of them."""

from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated

import tyro

from gelgap import adapt, domains
from gelgap.assets.progress import shown_progress
from gelgap.cli import options as opt
from gelgap.cli.generation import LOCALLY, GenerationOptions


@dataclass(frozen=True)
class Pretrain(opt.Command):
    """Make domains with drawn gels, spheres, lights and cameras, and train one network on all of them to start from.

    The checkpoint is out/pretrained.pt, for `gelgap adapt --weights` with the same profile. The last tenth of the
    domains is held out, and the network is evaluated on it. Domains go to out/domains; run the command again to resume.

    For example:
      gelgap pretrain --domains 60 --frames 60 --out pretrained
      gelgap pretrain --domains 60 --frames 60 --out pretrained --dry-run
      gelgap pretrain --domains 60 --frames 60 --stream --out streamed
    """

    former = MappingProxyType(
        {
            "--without": opt.Former("0.3.0", "every kind of frame is drawn"),
        }
    )

    when_stopped = "finished shards, solves and epochs are kept, run the same command again to go on"
    fills_cache = True

    out: Annotated[Path, opt.output_folder]
    """Folder for the domains and the checkpoint."""
    domains: Annotated[int, opt.between(2, 9999)] = 60
    """How many domains are drawn."""
    frames: Annotated[int, opt.between(2, 100_000)] = 60
    """Frames of a domain: one without contact, then every depth of its press, straight and dragged, at drawn places."""
    ranges: Annotated[Path | None, opt.optional("TOML", "gelgap's own")] = None
    """Ranges that differ from those of assets/pretraining.toml."""
    profile: opt.ProfileName = "cpu"
    quality: opt.Quality = "draft"
    """Quality of physics and pictures."""
    size: opt.PictureSize = (160, 120)
    seed: opt.Seed = 0
    """Seed of all draws and of the training."""
    stream: opt.Flag = False
    """Make the frames while training, every epoch as many new ones, and store no data set: any contact, and four new
    lights, sensors and cameras for every 128 frames. Nothing is written but the checkpoint and what resuming needs."""
    generation: Annotated[GenerationOptions, tyro.conf.OmitArgPrefixes] = LOCALLY

    def run(self, started: float) -> None:
        """Say what it takes, generate, train and print the errors."""
        profile = adapt.Profile.named(self.profile)
        ranges = self.ranges and domains.PretrainingRanges.load(self.ranges)
        width, height = profile.image_size_px
        if self.size[0] < width or self.size[1] < height:
            raise ValueError(
                f"--size = {self.size[0]} {self.size[1]}: must be at least the {width} × {height} px of profile "
                f"{profile.name}"
            )
        drawn = {"seed": self.seed, "size_px": self.size, "quality": self.quality}
        if self.stream:
            _train_on_stream(domains.PressStream(ranges, **drawn), self, profile, self.domains * self.frames)
            return
        recipes = domains.pretraining_recipes(self.domains, self.frames, ranges, **drawn)
        self.generation.estimate(recipes)
        print(
            f"training {profile.source_epochs} epochs of at most {self.domains * self.frames} frames",
            flush=True,
        )
        if self.generation.dry_run:
            return
        self.generation.generate(recipes, self.out / "domains")
        folders = [self.out / "domains" / recipe.name for recipe in recipes]
        with shown_progress() as progress:
            print(adapt.pretrain(folders, self.out, profile, self.seed, progress=progress))


def _train_on_stream(
    stream: "domains.PressStream", command: Pretrain, profile: "adapt.Profile", frames_per_epoch: int
) -> None:
    """Say what the solves take, and train on frames that are made meanwhile."""
    solves = [solve for press in range(stream.ranges.presses) for solve in stream.plan(press).solved.solves]
    print(
        f"solves   {len(solves)} for {stream.ranges.presses} gels and spheres, as they are drawn, about "
        f"{sum(solve.expected_core_s for solve in solves):.0f} s of a core\n"
        f"training {profile.source_epochs} epochs of {frames_per_epoch} new frames each",
        flush=True,
    )
    if command.generation.dry_run:
        return
    from gelgap.adapt.few_labels import pretrain_on_stream

    with shown_progress() as progress:
        trained = pretrain_on_stream(
            stream, command.out, profile, command.seed, frames_per_epoch=frames_per_epoch, progress=progress
        )
        print(trained)
