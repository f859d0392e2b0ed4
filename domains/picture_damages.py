"""What is wrong with pictures and labels that lie in a folder with a table."""

from collections.abc import Iterator

import numpy as np

from gelgap.domains.folder import Damage
from gelgap.domains.labels import QUANTITIES, known_labels
from gelgap.domains.picture_folder import PictureFolder
from gelgap.domains.picture_header import check_picture
from gelgap.domains.stored import PictureFiles, StoredFrames


def header_damages(frames: StoredFrames) -> list[Damage]:
    """Return the pictures whose bytes are no picture, or state another size than the reference; none is decoded."""
    found = []
    for index in range(len(frames)):
        try:
            size = check_picture(frames.encoded_picture(index))
        except (OSError, ValueError) as error:
            found.append(Damage(frames.place_of(index), f"frame {index}: {error}"))
            continue
        if size != frames.size_px:
            found.append(
                Damage(frames.place_of(index), f"frame {index}: {_another_size(size, frames.size_px)}")
            )
    return found


def table_damages(frames: PictureFiles) -> Iterator[Damage]:
    """Yield every picture that cannot be decoded to the reference's size, and every label that is not a number."""
    headers = header_damages(frames)
    wrong = {damage.file for damage in headers}
    yield from headers
    for index in range(len(frames)):
        if frames.place_of(index) not in wrong:
            try:
                frames.picture(index)
            except ValueError as error:
                yield Damage(frames.place_of(index), str(error).partition("; `gelgap")[0])
    for path in frames.reference_paths if isinstance(frames, PictureFolder) else ():
        try:
            frames.reference_picture(path)
        except ValueError as error:
            yield Damage(str(path.relative_to(frames.folder)), str(error))
    for name in known_labels(frames.columns):
        for index in np.flatnonzero(~np.isfinite(frames.columns[name])):
            value, symbol = frames.columns[name][index], QUANTITIES[name].symbol
            yield Damage(frames.place_of(index), f"frame {index} has {symbol} = {value} in the table")


def _another_size(size_px: tuple[int, int], reference_px: tuple[int, int]) -> str:
    return f"{size_px[0]}×{size_px[1]} px, the reference has {reference_px[0]}×{reference_px[1]} px"
