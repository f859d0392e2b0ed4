"""Frames as somebody's folder of pictures."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from gelgap.data import LabelledFrames
from gelgap.data.formats.pictures import encode_png


def write_pictures(folder: Path, frames: LabelledFrames, **columns: Sequence[Any]) -> Path:
    """Write pictures and their reference, and, if there are columns, a table; return the folder."""
    folder.mkdir(exist_ok=True)
    (folder / "reference.png").write_bytes(encode_png(frames.reference))
    for number in range(len(frames)):
        (folder / f"{number}.png").write_bytes(encode_png(frames.picture(number)))
    if columns:
        table = pd.DataFrame({"image": [f"{number}.png" for number in range(len(frames))]} | columns)
        table.to_csv(folder / "table.csv", index=False)
    return folder


def forces_of(frames: LabelledFrames) -> dict[str, Any]:
    """Return the columns of all axes of the force."""
    return {name: frames.columns[name] for name in ("fx_n", "fy_n", "fz_n")}
