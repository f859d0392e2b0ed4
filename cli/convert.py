"""`gelgap convert`: recordings of real sensors made into picture folders."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from gelgap.cli.options import Command, between, input_folder, output_folder

if TYPE_CHECKING:
    from gelgap.domains import ConvertedClip


@dataclass(frozen=True)
class Convert(Command):
    """Write recordings of a real sensor as folders of pictures with a table, which the other commands read.

    Layouts:
      wedge: grasps with a GelSight Wedge (git clone https://github.com/GelSight-lab/EstimateModulus)
      ball-presses: a ball on a GelSight with dots (git clone https://github.com/yanglh14/gelsight)
      recordings: your own. For each clip press.csv with time_s and fz_n, and press.mp4; or a folder press/ of
        pictures and a table with picture and time_s.

    The lag between pictures and forces is estimated for each clip from the clip itself, and printed.

    For example:
      gelgap convert clones/EstimateModulus --layout wedge --out wedge
    """

    when_stopped: ClassVar[str] = "nothing was written; run the same command again to start over"

    folder: Annotated[
        tyro.conf.Positional[Path],
        input_folder("a clone (gelgap convert --help says how to get one), or a folder of recordings,"),
    ]
    """Folder of the clone, or of your recordings."""
    layout: Literal["wedge", "ball-presses", "recordings"]
    """What the folder holds."""
    out: Annotated[Path, output_folder]
    """New folder that gets a folder for each domain."""
    every: Annotated[int, between(1, 1000)] = 1
    """Of the pictures in contact, write every n-th."""

    def run(self, started: float) -> None:
        """Convert, print what became of each clip, and name what was written."""
        from gelgap.benchmarks.real.published_sets import LAYOUTS
        from gelgap.domains import convert

        clips = convert(self.folder, LAYOUTS.get(self.layout, self.layout), self.out, self.every)
        print(_table(clips))
        for domain in dict.fromkeys(clip.domain for clip in clips):
            print(f"wrote {self.out / domain}")


def _table(clips: "Sequence[ConvertedClip]") -> str:
    """Return a line for each clip, a sum for each session, and what the lags say."""
    name_width = max(len(clip.name) for clip in clips)
    lines = []
    for session in dict.fromkeys(clip.session for clip in clips):
        own = [clip for clip in clips if clip.session == session]
        lines += [
            f"{session:<{name_width}} {'pictures':>8} {'in contact':>10} {'dropped':>7} {'written':>7} "
            f"{'lag':>4} {'r':>6} {'at 0':>6}   RGB at rest"
        ]
        if own[0].name != session:
            lines += [_line(clip.name, [clip], name_width) for clip in own]
        lines += [_line("together", own, name_width), ""]
    if any(clip.lag is not None for clip in clips):
        lines.append(
            "lag: by how many pictures the forces trail, by the clip itself; r: how the two correlate there and at 0"
        )
    noted = {
        "the largest lag that was tried fits best, so the clocks may differ by more": "lag_at_limit",
        "begins with a force, so its reference is its first picture": "begins_in_contact",
    }
    for what, field in noted.items():
        if names := [f"{clip.session}/{clip.name}" for clip in clips if getattr(clip, field)]:
            lines.append(f"{what}: {', '.join(names)}")
    return "\n".join(lines)


def _line(name: str, clips: "Sequence[ConvertedClip]", name_width: int) -> str:
    pictures, in_contact, dropped, written = (
        sum(getattr(clip, count) for clip in clips)
        for count in ("pictures", "in_contact", "dropped", "written")
    )
    colours = zip(*(clip.reference_rgb for clip in clips), strict=True)
    rgb = " ".join(f"{sum(channel) / len(clips):5.1f}" for channel in colours)
    aligned = " " * 18
    if len(clips) == 1 and clips[0].lag is not None:
        clip = clips[0]
        aligned = f"{clip.lag:4} {clip.correlation:6.3f} {clip.correlation_at_0:6.3f}"
    counts = f"{pictures:8} {in_contact:10} {dropped:7} {written:7}"
    return f"{name:<{name_width}} {counts} {aligned}   {rgb}"
