"""What training on few labels starts from: nothing, or a checkpoint of `gelgap pretrain`, perhaps with less drawn."""

from pathlib import Path

from gelgap.benchmarks.adaptation.jobs import Bench

SCRATCH, PRETRAINED = "scratch", "pretrained"
_WITHOUT = "without-"
_DOMAINS, _FRAMES = 60, 60
_QUICK_DOMAINS, _QUICK_FRAMES, _QUICK_EPOCHS = 2, 12, 1


def checkpoint_of(bench: Bench, start: str) -> Path | None:
    """Return the checkpoint of a start, None for the one from scratch."""
    return None if start == SCRATCH else bench.out / start / "pretrained.pt"


def without(factor: str) -> str:
    """Return the name of the start for whose pretraining one factor is the same in all domains."""
    return f"{_WITHOUT}{factor}"


def pretrain_once(bench: Bench, start: str = PRETRAINED) -> None:
    """Generate the domains of a start and pretrain, unless the checkpoint is there."""
    checkpoint = checkpoint_of(bench, start)
    if checkpoint.is_file():
        return
    from gelgap.adapt import Profile, console_progress, pretrain
    from gelgap.domains import PretrainingRanges, generate_recipes, pretraining_recipes, shown_progress

    ranges, profile = PretrainingRanges.default(), Profile.preset(bench.profile)
    domains, frames = _DOMAINS, _FRAMES
    if bench.is_quick:
        ranges, profile = ranges.in_quick_form(), profile.replace(source_epochs=_QUICK_EPOCHS)
        domains, frames = _QUICK_DOMAINS, _QUICK_FRAMES
    undrawn = [start.removeprefix(_WITHOUT)] if start.startswith(_WITHOUT) else []
    recipes = pretraining_recipes(domains, frames, ranges, without=undrawn)
    folder = checkpoint.parent / "domains"
    scheduler = "synchronous" if bench.workers == 1 else None
    with shown_progress() as progress:
        generate_recipes(recipes, folder, scheduler=scheduler, workers=bench.workers, progress=progress)
    with console_progress() as progress:
        folders = [folder / recipe.name for recipe in recipes]
        print(pretrain(folders, checkpoint.parent, profile, progress=progress), flush=True)
