"""`gelgap convert`: recordings of real sensors made into picture folders."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gelgap import domains
from gelgap.cli import options as opt


@dataclass(frozen=True)
class Convert(opt.Command):
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

    folder: Annotated[tyro.conf.Positional[Path], opt.input_folder("a clone, or a folder of recordings,")]
    """Folder of the clone, or of your recordings."""
    layout: Literal["wedge", "ball-presses", "recordings"]
    """What the folder holds."""
    out: Annotated[Path, opt.output_folder]
    """New folder that gets a folder for each domain."""
    every: Annotated[int, opt.between(1, 1000)] = 1
    """Of the pictures in contact, write every n-th."""

    def run(self, started: float) -> None:
        """Convert, print what became of each clip, and name what was written."""
        from gelgap.benchmarks.real.published_sets import LAYOUTS

        clips = domains.convert(self.folder, LAYOUTS.get(self.layout, self.layout), self.out, self.every)
        print(_table(clips))
        for domain in dict.fromkeys(clip.domain for clip in clips):
            print(f"wrote {self.out / domain}")


def _table(clips: "Sequence[domains.ConvertedClip]") -> str:
    """Return a table of the clips, one of all of a session together, and what the lags say."""
    import pandas as pd

    means = dict.fromkeys(("R at rest", "G", "B"), "mean")
    sums = dict.fromkeys(("pictures", "in contact", "dropped", "written"), "sum")
    formats = dict.fromkeys(means, "{:.1f}".format) | dict.fromkeys(("r", "r at 0"), "{:.3f}".format)
    formats["lag"] = "{:.0f}".format
    names = {"in_contact": "in contact", "correlation": "r", "correlation_at_0": "r at 0"}
    every = pd.DataFrame(map(vars, clips)).rename(columns=names)
    every[[*means]] = every["reference_rgb"].tolist()
    by_clip = every.set_index(["session", "name"])[[*sums, "lag", "r", "r at 0", *means]]
    by_session = by_clip.groupby(level="session", sort=False).agg(sums | means)
    lines = [own.to_string(formatters=formats, na_rep="") + "\n" for own in (by_clip, by_session)]
    if every["lag"].notna().any():
        lines.append(
            "lag: by how many pictures the forces trail, by the clip itself; r: how the two correlate there and at 0"
        )
    noted = {
        "the largest lag that was tried fits best, so the clocks may differ by more": "lag_at_limit",
        "begins with a force, so its reference is its first picture": "begins_in_contact",
    }
    for what, field in noted.items():
        if every[field].any():
            lines.append(f"{what}: {', '.join((every['session'] + '/' + every['name'])[every[field]])}")
    return "\n".join(lines)
