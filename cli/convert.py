"""`gelgap convert`: recordings of real sensors made into picture folders."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from gelgap import data
from gelgap.cli import options as opt

if TYPE_CHECKING:
    from gelgap.data.formats.convert import ConvertedClip

LEAST_LIKELY = 0.75
"""Of pictures and forces: 0.85 to 0.99 in 18 clips of a real sensor, 0.3 to 0.6 in a light that changes."""


@dataclass(frozen=True)
class Convert(opt.Command):
    """Write recordings of a real sensor as folders of pictures with a table, which the other commands read.

    Layouts:
      wedge: grasps with a GelSight Wedge (git clone https://github.com/GelSight-lab/EstimateModulus)
      ball-presses: a ball on a GelSight with dots (git clone https://github.com/yanglh14/gelsight)
      recordings: your own. For each clip press.csv with time_s and fz_n, and press.mp4; or a folder press/ of
        pictures and a table with picture and time_s.

    The lag between pictures and forces is estimated for each clip from the clip itself, and printed with the range of
    lags that fit as well.

    For example:
      gelgap convert clones/EstimateModulus --layout wedge --out wedge
    """

    folder: Annotated[tyro.conf.Positional[Path], opt.input_folder("a clone, or a folder of recordings,")]
    """Folder of the clone, or of your recordings."""
    layout: Literal["wedge", "ball-presses", "recordings"]
    """What the folder holds."""
    out: Annotated[Path, opt.output_folder]
    """New folder that gets a folder for each domain."""
    every: Annotated[int, opt.between(1, 1000)] = 1
    """Of the pictures in contact, write every n-th."""
    lag: Annotated[int | None, opt.optional("FRAMES"), opt.between(-1000, 1000)] = None
    """By how many pictures the forces trail, where you know it; 0 takes the clocks as they are."""

    def run(self, started: float) -> None:
        """Convert, print what became of each clip, and name what was written."""
        from gelgap.data.formats.published_sets import LAYOUTS

        if self.lag is not None and self.layout == "ball-presses":
            raise ValueError(f"--lag {self.lag}: pictures of ball-presses have marks, no times; leave it out")
        layout = LAYOUTS.get(self.layout, self.layout)
        clips = data.convert(self.folder, layout, self.out, self.every, self.lag)
        print(_table(clips))
        for domain in dict.fromkeys(clip.domain for clip in clips):
            print(f"wrote {self.out / domain}")


def _table(clips: "Sequence[ConvertedClip]") -> str:
    """Return a table of the clips, one of all of a session together, and what the lags say."""
    import pandas as pd

    means = dict.fromkeys(("R at rest", "G", "B"), "mean")
    sums = dict.fromkeys(("pictures", "in contact", "dropped", "left out", "written"), "sum")
    formats = dict.fromkeys(means, "{:.1f}".format) | dict.fromkeys(("r", "r at 0"), "{:.3f}".format)
    formats["lag"] = "{:g}".format
    names = {
        "in_contact": "in contact",
        "left_out": "left out",
        "lag_range": "range",
        "correlation": "r",
        "correlation_at_0": "r at 0",
    }
    every = pd.DataFrame(map(vars, clips)).rename(columns=names)
    every[[*means]] = every["reference_rgb"].tolist()
    every["range"] = [
        f"{clip.lag_range[0]:g}…{clip.lag_range[1]:g}" if clip.lag_range else "" for clip in clips
    ]
    every = every.astype({"lag": float, "r": float, "r at 0": float})
    by_clip = every.set_index(["session", "name"])[[*sums, "lag", "range", "r", "r at 0", *means]]
    by_session = by_clip.groupby(level="session", sort=False).agg(sums | means)
    lines = [table.to_string(formatters=formats, na_rep="") + "\n" for table in (by_clip, by_session)]
    if every["lag"].notna().any():
        lines.append(
            "lag: by how many pictures the forces trail, by the clip itself unless you stated it; range: the lags that "
            "fit as well; r: how pictures and forces correlate at the lag and at 0"
        )
    noted = defaultdict(list)
    for clip in clips:
        name = f"{clip.session}/{clip.name}"
        if clip.lag_at_limit:
            noted["the largest lag that was tried fits best, so the clocks may differ by more"].append(name)
        if not clip.in_contact:
            noted["no force above 0.3 N, so that all is at rest: is its unit right?"].append(name)
        if clip.begins_in_contact:
            noted["begins with a force, so its reference is its first picture; is Fz 0 at rest?"].append(name)
        if clip.correlation is not None and clip.correlation < max(LEAST_LIKELY, -clip.correlation_at_0):
            noted["pictures hardly follow the force: steady light? right sign of Fz? 0 at rest?"].append(name)
        if clip.in_holes:
            noted["pictures without labels, in holes of the log"].append(f"{name} ({clip.in_holes})")
        for note in clip.notes:
            noted[note].append(name)
    lines += [f"{what}: {', '.join(names)}" for what, names in noted.items()]
    return "\n".join(lines)
