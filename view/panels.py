"""Parts of the page that show things: camera and figures, and a source beside the target."""

from html import escape
from typing import Any

import numpy as np
import viser

from gelgap.assets.pages import html_page
from gelgap.data.formats.pictures import encode_jpeg
from gelgap.domains.gap import DomainGap, markers_gap
from gelgap.domains.recipe import shown_markers
from gelgap.view.pictures import SIZE_PX, Picture, PictureMaker
from gelgap.view.state import Configuration, Shown

_GOOD, _BAD, _MIDDLING = "#2b8a3e", "#c92a2a", "#b08900"
_GREY = np.full((SIZE_PX[1], SIZE_PX[0], 3), 128, np.uint8)


class PicturePair:
    """Two pictures, one above the other, which appear when they are first shown."""

    def __init__(self, gui: viser.GuiApi, *labels: str) -> None:
        self._handles = [gui.add_image(_GREY, label=each, jpeg_quality=92, visible=False) for each in labels]

    def show(self, *pictures: Picture) -> None:
        """Show both."""
        for handle, picture in zip(self._handles, pictures, strict=True):
            handle.image, handle.visible = picture, True


class Readout:
    """What is read off the page: pictures, force, contact, where the physics is from, and how long it took."""

    def __init__(self, gui: viser.GuiApi) -> None:
        self._pictures = PicturePair(gui, "camera", "difference to the reference, ×2")
        self.figures = gui.add_html("")
        self.message = gui.add_html("")
        self.progress = gui.add_progress_bar(0.0, visible=False, animated=True)

    def show(self, shown: Shown, difference: Picture, colours: str) -> None:
        """Show a configuration's figures and pictures."""
        self._pictures.show(shown.picture, difference)
        self.figures.content = html_page("panel.html", **_figures(shown, colours))

    def say(self, sentence: str, bad: bool = False) -> None:
        """Show a sentence below the figures; an empty one takes the last away."""
        self.message.content = sentence_html(sentence, bad) if sentence else ""

    def show_progress(self, done: int, total: int) -> None:
        """Show how much of a solve is done; nothing once it is all done."""
        self.progress.visible = done < total
        set_value(self.progress, 100.0 * done / max(total, 1))


def set_value(knob: Any, value: Any) -> None:
    """Turn a knob; to mypy the values of viser's are read-only."""
    knob.value = value


def sentence_html(sentence: str, bad: bool) -> str:
    """Return a sentence as HTML, a bad one in red."""
    style = f"padding:4px 12px;font-size:12px;color:{_BAD if bad else 'inherit'}"
    return f'<div style="{style}">{escape(sentence)}</div>'


def _figures(shown: Shown, colours: str) -> dict[str, Any]:
    """Return the figures of what is shown, and how far its physics can be trusted, as `panel.html` takes them."""
    state = shown.solved
    found = state.diagnostics
    # Adding zero turns −0.000 into 0.000.
    forces = zip("xyz", state.force_n.round(3) + 0.0, found.force_error_n, strict=True)
    rows = [("indenter", shown.configuration.indenter.label)]
    rows += [(f"F{axis}", f"{value:+.3f} ± {error:.3f} N") for axis, value, error in forces]
    rows.append(("contact radius", f"{state.contact_radius_mm:.3f} ± {found.contact_radius_error_mm:.3f} mm"))
    rows.append(("largest displacement", f"{np.linalg.norm(state.displacement_mm, axis=-1).max():.3f} mm"))
    rows.append(("largest pressure, of ½ mm", f"{shown.pressure_mpa.max():.3f} MPa"))
    verdict, colour = ("converged", _GOOD) if shown.exact else ("draft", _MIDDLING)
    if found.coarse:
        verdict, colour = f"{verdict}, but coarse: a finer quality is needed", _MIDDLING
    if not state.converged:
        verdict, colour = "FOLDED MEMBRANE" if found.folded else "NOT CONVERGED", _BAD
    stages = ", ".join(f"{name} {ms:.0f} ms" for name, ms in shown.stages_ms.items()) or "nothing to do"
    said = {"verdict": verdict, "colour": colour, "source": shown.source, "colours": colours}
    return said | {"rows": rows, "stages": stages}


def narrow_html(shown: Shown, colours: str) -> str:
    """Return picture and figures as HTML for windows too narrow for panels side by side; hidden in wider ones."""
    return html_page("panel.html", picture=encode_jpeg(shown.picture, 85), **_figures(shown, colours))


class ComparePanel:
    """The tab that keeps a configuration as the source, and tells the gap from there to what is shown, the target."""

    def __init__(self, gui: viser.GuiApi, pictures: PictureMaker) -> None:
        self._pictures = pictures
        self.source: Shown | None = None
        gui.add_markdown(
            "Keep what you see as the **source** of a gap, then turn the knobs: the page is its **target**."
        )
        self.keep = gui.add_button("Keep this as the source")
        self.swap = gui.add_button("Swap source and target", disabled=True)
        self.recipe = gui.add_button(
            "Save both as a recipe", disabled=True, hint="gelgap generate gap.toml --out data"
        )
        self._pair = PicturePair(gui, "source", "target")
        self.figures = gui.add_html("")

    def take(self, source: Shown) -> None:
        """Make something the source."""
        self.source = source
        self.swap.disabled = self.recipe.disabled = False

    def update(self, target: Shown) -> None:
        """Tell the gap to a new target."""
        if self.source is not None:
            self._pair.show(self.source.picture, target.picture)
            gap = compare(self.source.configuration, target.configuration, self._pictures)
            self.figures.content = gap_html(gap, self.source, target)


def compare(source: Configuration, target: Configuration, pictures: PictureMaker) -> DomainGap:
    """Return the gap between two configurations, as `domain_gap` has it for domains, without fields."""
    seen = pictures.colour_gap(source.lit, target.lit)
    marked = markers_gap(*(shown_markers(own.sensor, own.markers) for own in (source, target)))
    ratio = target.elastomer.young_modulus_mpa / source.elastomer.young_modulus_mpa
    return DomainGap(ratio, seen.mean, seen.percentile_95, marked, fields=())


def gap_html(gap: DomainGap, source: Shown, target: Shown) -> str:
    """Return the gap and the forces of both sides as HTML."""
    forces = [
        " ".join(f"{value:+.2f}" for value in shown.solved.force_n.round(2) + 0.0)
        for shown in (source, target)
    ]
    rows = (
        ("CIEDE2000, mean", f"{gap.colour_difference:.2f}"),
        ("CIEDE2000, 95th percentile", f"{gap.colour_difference_p95:.2f}"),
        ("modulus ratio", f"{gap.modulus_ratio:.3g}"),
        ("markers", gap.markers),
        ("force of the source, N", forces[0]),
        ("force of the target, N", forces[1]),
        ("physics of the source", source.source),
        ("physics of the target", target.source),
    )
    return html_page("panel.html", rows=rows)
