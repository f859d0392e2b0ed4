"""Pretraining: one network learns the forces of many domains at once, each relative to its own reference."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gelgap.adapt.evaluation import Evaluation, evaluate, evaluate_constant_mean
from gelgap.adapt.profile import Profile
from gelgap.adapt.progress import Progress, silent
from gelgap.adapt.runs import Stage1
from gelgap.domains import join_domains, open_domain, within_range

CHECKPOINT = "pretrained.pt"
# The last of the domains are kept for judging: one in this many.
_HELD_OUT_OF = 10


@dataclass(frozen=True)
class Pretraining:
    """A pretrained network: its checkpoint, the frames that it has learnt from, and its error on unseen domains."""

    checkpoint: Path
    frames: int
    left_out: int
    held_out: Evaluation
    held_out_constant_mean: Evaluation

    def __str__(self) -> str:
        lines = [
            f"{self.checkpoint}: trained on {self.frames} frames",
            f"{'MAE in N':<28} {'Fx':>7} {'Fy':>7} {'Fz':>7}",
        ]
        for name, error in (("constant mean", self.held_out_constant_mean), ("pretrained", self.held_out)):
            values = " ".join(f"{value:7.4f}" for value in error.mae_n)
            lines.append(f"{name + ', unseen domains':<28} {values}")
        if self.left_out:
            lines.append(f"{self.left_out} frames with a force outside the declared range were left out")
        return "\n".join(lines)


def pretrain(
    folders: Sequence[str | Path],
    out_dir: str | Path,
    profile: str | Profile = "cpu",
    seed: int = 0,
    *,
    progress: Progress = silent,
) -> Pretraining:
    """Train stage 1 on many domains, and judge it on the last tenth of them, which it does not see.

    The checkpoint `pretrained.pt` in `out_dir` is one that `adapt_folders` takes as `weights`. An interrupted training
    goes on from its last epoch, a finished one is not repeated.

    Raises
    ------
    ValueError
        If there are fewer than two domains, the profile is unknown, or domains do not fit together.
    RuntimeError
        If another process is training it.
    """
    profile = profile if isinstance(profile, Profile) else Profile.preset(profile)
    if len(folders) < 2:
        raise ValueError(f"{len(folders)} domains: pretraining needs 2 or more, the last to judge by")
    domains = [open_domain(folder) for folder in folders]
    within = [within_range(domain) for domain in domains]
    held_out = max(1, len(domains) // _HELD_OUT_OF)
    seen = join_domains(within[:-held_out])
    unseen = join_domains(within[-held_out:])
    model, _ = Stage1(seen, profile, seed, out=Path(out_dir), progress=progress).model()
    checkpoint = Path(out_dir) / CHECKPOINT
    model.save(checkpoint)
    return Pretraining(
        checkpoint=checkpoint,
        frames=len(seen),
        left_out=sum(map(len, domains)) - sum(map(len, within)),
        held_out=evaluate(model, unseen),
        held_out_constant_mean=evaluate_constant_mean(seen, unseen),
    )
