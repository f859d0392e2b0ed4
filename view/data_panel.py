"""The tab that opens a domain on disk and leads through its frames."""

from html import escape
from pathlib import Path

import numpy as np
import viser

from gelgap.domains import QUANTITIES, LabelledFrames, open_domain
from gelgap.view.pictures import Picture, difference

# What is told of a frame beside its labels, where the data set has it.
_COLUMNS = ("shear_x_mm", "shear_y_mm", "contact_class", "clip", "object", "session")
_SHOWN_WIDTH_PX = 320


class DataPanel:
    """A folder's frames, one at a time: picture, difference to the frame's reference, and labels."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._frames: LabelledFrames | None = None
        self._references = np.empty((0, 0, 0, 3), np.uint8)
        self._folder = gui.add_text("folder", "", hint="The folder of one domain, such as data/mb0i0")
        opened = gui.add_button("Open")
        self._index = gui.add_slider("frame", 0, 1, 1, 0, disabled=True)
        grey = np.full((240, 320, 3), 128, np.uint8)
        self._picture = gui.add_image(grey, label="frame", jpeg_quality=92, visible=False)
        self._difference = gui.add_image(grey, label="difference, ×2", jpeg_quality=92, visible=False)
        self._labels = gui.add_html("")
        opened.on_click(lambda _: self.open(self._folder.value))
        self._index.on_update(lambda _: self.show(int(self._index.value)))

    def open(self, folder: str) -> None:
        """Open a domain and show its first frame, or say why it cannot be opened."""
        if not folder.strip():
            self._say("name the folder of one domain, such as data/mb0i0")
            return
        try:
            frames = open_domain(Path(folder.strip()).expanduser())
            self._references = frames.references_at()
        except (ValueError, OSError, RuntimeError) as error:
            self._say(str(error))
            return
        self._frames = frames
        self._index.max = max(len(frames) - 1, 1)
        self._index.disabled = False
        for part in (self._picture, self._difference):
            part.visible = True
        self._index.value = 0
        self.show(0)

    def show(self, index: int) -> None:
        """Show a frame, or say why it cannot be read."""
        frames = self._frames
        if frames is None:
            return
        index = min(index, len(frames) - 1)
        try:
            picture = frames.picture(index)
        except (ValueError, OSError, RuntimeError) as error:
            self._say(str(error))
            return
        self._picture.image = _enlarged(picture)
        self._difference.image = _enlarged(difference(picture, self._references[frames.reference_id[index]]))
        self._labels.content = labels_html(frames, index)

    def _say(self, sentence: str) -> None:
        self._labels.content = f'<div style="padding:4px 12px;color:#c92a2a">{escape(sentence)}</div>'


def labels_html(frames: LabelledFrames, index: int) -> str:
    """Return a frame's labels, and what else is known of it, as HTML."""
    rows = [("domain", frames.name), ("frame", f"{index} of {len(frames)}")]
    columns = frames.columns
    for name, (symbol, unit) in QUANTITIES.items():
        if name in columns:
            rows.append((f"{symbol}, {unit}", f"{columns[name][index]:+.3f}"))
    rows += [(name, str(columns[name][index])) for name in _COLUMNS if name in columns]
    cells = "".join(
        f'<tr><td style="opacity:.7;padding-right:10px">{name}</td><td><b>{escape(value)}</b></td></tr>'
        for name, value in rows
    )
    return f'<table style="font-size:12px;margin:4px 12px">{cells}</table>'


def _enlarged(picture: Picture) -> Picture:
    """Return a small picture with each pixel repeated, so that it can be seen."""
    times = max(1, _SHOWN_WIDTH_PX // picture.shape[1])
    return picture.repeat(times, axis=0).repeat(times, axis=1)
