"""Predictions for pictures in files or from a camera, with a note where a prediction is not to be trusted."""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from gelgap.adapt.inputs import INPUTS
from gelgap.adapt.model import AffineCorrection, ForceModel
from gelgap.assets.image_file import SUFFIXES, picture_files, read_image, visible_files
from gelgap.data import Labels
from gelgap.data.formats.domain_folder import MANIFEST
from gelgap.data.formats.pictures import mismatch
from gelgap.data.frames.first_touch import change_of, dent_pixels
from gelgap.data.frames.levelling import levelled

NamedPicture = tuple[str, np.ndarray]
# Of a range: the network's sigmoid comes no closer to a bound, however far beyond it the truth is.
_AT_THE_END = 0.01


def predict_each(
    model: ForceModel, pictures: Iterable[NamedPicture], reference: np.ndarray
) -> Iterator[dict[str, object]]:
    """Yield a row for each picture: its name as `picture`, the labels by name, each in its unit, and a `note`.

    A model of trajectories takes the pictures of a folder, or of a camera, as one in the order given.

    Raises
    ------
    ValueError
        If a picture cannot be predicted (see `ForceModel.predict`); the message names it.
    """
    clip: Path | None = None
    latest: deque[np.ndarray] = deque(maxlen=model.profile.sequence_length)
    # Of as many before the picture: the one in which its contact began, none without contact.
    touches: deque[list[np.ndarray]] = deque(maxlen=model.profile.sequence_length)
    for name, picture in pictures:
        if clip != Path(name).parent:
            clip = Path(name).parent
            latest.clear()
            touches.clear()
            touches.append([])
        latest.append(picture)
        try:
            if latest[0].shape != picture.shape:
                raise ValueError("it has another size than the picture before it in its folder")
            predicted = (
                model.predict(np.stack([*touches[0], *latest]), reference)[-1]
                if model.profile.needs_trajectories
                else model.predict(picture, reference)
            )
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
        if INPUTS[model.profile.input].from_touch:
            own = levelled(picture[None], reference)[0] if model.profile.levelling else picture
            change = change_of(own, reference, model.profile.image_size_px)
            touches.append((touches[-1] or [picture]) if len(dent_pixels(change)) else [])
        labels = dict(zip(model.labels.names, predicted.tolist(), strict=True))
        notes = [range_note(model.labels, predicted, model.correction), mismatch(picture, reference)]
        yield {"picture": name, **labels, "note": "; ".join(filter(None, notes))}


def range_note(labels: Labels, predicted: np.ndarray, correction: AffineCorrection | None = None) -> str:
    """Return what is wrong with predicted labels (k,): no number, or at the end of a label's range, or beyond it.

    Ranges are the network's, whose output the correction has changed. A bound of 0, the force without contact, is
    reached by right predictions.
    """
    gain, offset = correction or (np.ones(len(labels)), np.zeros(len(labels)))
    read = (predicted - np.asarray(offset)) / gain
    notes = []
    for k, ((symbol, unit), (low, high), value) in enumerate(
        zip(labels.quantities, labels.ranges, read, strict=True)
    ):
        margin = _AT_THE_END * (high - low)
        if not np.isfinite(value):
            notes.append(f"{symbol} is not a number")
        elif value < low + margin * (low != 0) or value > high - margin * (high != 0):
            first, last = (bound * gain[k] + offset[k] for bound in (low, high))
            notes.append(
                f"{symbol} is at the end of the trained range, {first:g} to {last:g} {unit}, or beyond"
            )
    return "; ".join(notes)


def read_pictures(paths: Sequence[Path]) -> Iterator[NamedPicture]:
    """Yield the pictures of files and of folders, those of a folder by their names, frame_2 before frame_10.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If a file is not an image that can be read, or a folder has none.
    """
    for path in paths:
        if (path / MANIFEST).exists():
            raise ValueError(f"{path} is a generated domain; gelgap export writes its pictures as files")
        files = picture_files(visible_files(path)) if path.is_dir() else [path]
        if not files:
            raise ValueError(f"folder {path} has no picture ({', '.join(SUFFIXES)})")
        for file in files:
            yield str(file), read_image(file)


def camera_pictures(index: int) -> Iterator[NamedPicture]:
    """Yield the pictures of a camera, named by their number, until it gives no more.

    Raises
    ------
    ValueError
        If it gives none.
    """
    import cv2

    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the sentence below is enough
    camera = cv2.VideoCapture(index)
    number = 0
    try:
        while (taken := camera.read())[0]:
            yield str(number), np.ascontiguousarray(taken[1][..., ::-1])
            number += 1
    finally:
        camera.release()
    if number == 0:
        raise ValueError(
            f"camera {index} gives no picture: see that it is connected and no other program uses it"
        )
