"""What is wrong with pictures and forces that lie in a folder with a table."""

from collections.abc import Iterator

import numpy as np

from gelgap.domains.dataset import FORCE_COLUMNS
from gelgap.domains.folder import Damage
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
    """Yield every picture that cannot be decoded to the reference's size, and every force that is not a number."""
    headers = header_damages(frames)
    wrong = {damage.file for damage in headers}
    yield from headers
    for index in range(len(frames)):
        if frames.place_of(index) not in wrong:
            try:
                frames.picture(index)
            except ValueError as error:
                yield Damage(frames.place_of(index), str(error).partition("; `gelgap")[0])
    for index, axis in np.argwhere(~np.isfinite(frames.force_n)):
        value = frames.columns[FORCE_COLUMNS[axis]][index]
        yield Damage(frames.place_of(index), f"frame {index} has F{'xyz'[axis]} = {value} in the table")


def _another_size(size_px: tuple[int, int], reference_px: tuple[int, int]) -> str:
    return f"{size_px[0]}×{size_px[1]} px, the reference has {reference_px[0]}×{reference_px[1]} px"
