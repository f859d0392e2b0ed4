"""The camera's picture and the figures beside the scene."""

from html import escape

import numpy as np
import viser

from gelgap.view.live import Shown
from gelgap.view.pictures import Picture

_CELL = "padding:2px 10px 2px 0"
_GOOD, _BAD, _MIDDLING = "#2b8a3e", "#c92a2a", "#b08900"


class Readout:
    """What is read off the page: pictures, force, contact, where the physics is from, and how long it took."""

    def __init__(self, gui: viser.GuiApi) -> None:
        grey = np.full((240, 320, 3), 128, np.uint8)
        self.picture = gui.add_image(grey, label="camera", jpeg_quality=92)
        self.difference = gui.add_image(grey, label="difference to the reference, ×2", jpeg_quality=92)
        self.figures = gui.add_html("")
        self.message = gui.add_html("")
        self.progress = gui.add_progress_bar(0.0, visible=False, animated=True)

    def show(self, shown: Shown, difference: Picture, colours: str) -> None:
        """Show a configuration's figures and pictures."""
        self.picture.image = shown.picture
        self.difference.image = difference
        self.figures.content = figures_html(shown, colours)

    def say(self, sentence: str, bad: bool = False) -> None:
        """Show a sentence below the figures; an empty one takes the last away."""
        colour = _BAD if bad else "inherit"
        self.message.content = (
            f'<div style="padding:4px 12px;font-size:12px;color:{colour}">{escape(sentence)}</div>'
            if sentence
            else ""
        )

    def show_progress(self, done: int, total: int) -> None:
        """Show how much of a solve is done; nothing once it is all done."""
        self.progress.visible = done < total
        self.progress.value = 100.0 * done / max(total, 1)


def figures_html(shown: Shown, colours: str) -> str:
    """Return the figures of what is shown as HTML."""
    state = shown.solved.state
    rows = [(f"F{axis}", f"{value:+.3f} N") for axis, value in zip("xyz", state.force_n + 0.0, strict=True)]
    rows.append(("contact radius", f"{state.contact_radius_mm:.3f} mm"))
    rows.append(("largest displacement", f"{np.linalg.norm(state.displacement_mm, axis=-1).max():.3f} mm"))
    rows.append(("largest pressure", f"{shown.solved.pressure_mpa.max():.3f} MPa"))
    cells = "".join(
        f'<tr><td style="{_CELL};opacity:.7">{name}</td>'
        f'<td style="text-align:right;font-variant-numeric:tabular-nums"><b>{value}</b></td></tr>'
        for name, value in rows
    )
    verdict, colour = _verdict(shown)
    stages = ", ".join(f"{name} {ms:.0f} ms" for name, ms in shown.stages_ms.items()) or "nothing to do"
    said = [f'<span style="color:{colour};font-weight:600">{verdict}</span>: {escape(shown.source)}.']
    if colours:
        said.append(escape(colours) + ".")
    said.append(f'<span style="opacity:.6">{stages}</span>')
    return (
        f'<div style="padding:4px 12px;font-size:13px"><table style="border-collapse:collapse">{cells}</table>'
        f'<div style="margin-top:6px;font-size:12px">{"<br>".join(said)}</div></div>'
    )


def _verdict(shown: Shown) -> tuple[str, str]:
    """Return how far the physics can be trusted, and a colour for it."""
    if not shown.solved.state.converged:
        return "NOT CONVERGED", _BAD
    return ("converged", _GOOD) if shown.exact else ("draft", _MIDDLING)
