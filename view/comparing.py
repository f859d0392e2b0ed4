"""The tab that sets a source beside the target, which is what the page shows."""

from typing import TYPE_CHECKING

import numpy as np
import viser

from gelgap.view.comparison import Comparison, compare
from gelgap.view.live import Shown
from gelgap.view.saving import recipe_toml

if TYPE_CHECKING:
    from gelgap.view.page import Page


class ComparePanel:
    """Keeps a configuration as the source, and tells the gap from there to what is shown, the target."""

    def __init__(self, gui: viser.GuiApi, page: "Page") -> None:
        self._page = page
        self._source: Shown | None = None
        gui.add_markdown(
            "Keep what you see as the **source** of a gap, then turn the knobs: the page is its **target**."
        )
        keep = gui.add_button("Keep this as the source")
        self._swap = gui.add_button("Swap source and target", disabled=True)
        self._recipe = gui.add_button(
            "Save both as a recipe", disabled=True, hint="gelgap generate --recipe gap.toml --out data"
        )
        grey = np.full((240, 320, 3), 128, np.uint8)
        self._picture = gui.add_image(grey, label="source", jpeg_quality=92, visible=False)
        self._target = gui.add_image(grey, label="target", jpeg_quality=92, visible=False)
        self._figures = gui.add_html("")
        keep.on_click(lambda _: page.do(self._keep))
        self._swap.on_click(lambda _: page.do(self._change_places))
        self._recipe.on_click(lambda event: page.do(lambda: self._save(event.client)))

    def update(self, shown: Shown) -> None:
        """Tell the gap to a new target."""
        if self._source is None:
            return
        self._target.image = shown.picture
        gap = compare(self._source.configuration, shown.configuration, self._page.model.pictures)
        self._figures.content = gap_html(gap, self._source, shown)

    def _keep(self) -> None:
        self._take(self._page.shown)

    def _take(self, source: Shown | None) -> None:
        if source is None:
            return
        self._source = source
        self._picture.image = source.picture
        for part in (self._picture, self._target):
            part.visible = True
        for button in (self._swap, self._recipe):
            button.disabled = False
        if self._page.shown is not None:
            self.update(self._page.shown)

    def _change_places(self) -> None:
        target, source = self._page.shown, self._source
        if source is not None and target is not None:
            self._take(target)
            self._page.controls.set_configuration(source.configuration)

    def _save(self, client: viser.ClientHandle | None) -> None:
        if client is not None and self._source is not None and self._page.shown is not None:
            content = recipe_toml(self._source.configuration, self._page.shown.configuration)
            client.send_file_download("gap.toml", content, save_immediately=True)
            self._page.say("saved gap.toml; make the data: gelgap generate --recipe gap.toml --out data")


def gap_html(gap: Comparison, source: Shown, target: Shown) -> str:
    """Return the gap and the forces of both sides as HTML."""
    forces = [
        " ".join(f"{value:+.2f}" for value in shown.solved.state.force_n.round(2) + 0.0)
        for shown in (source, target)
    ]
    rows = (
        ("CIEDE2000, mean", f"{gap.colour_difference:.2f}"),
        ("CIEDE2000, 95th percentile", f"{gap.colour_difference_p95:.2f}"),
        ("modulus ratio", f"{gap.modulus_ratio:.3g}"),
        ("markers", gap.markers),
        ("force of the source, N", forces[0]),
        ("force of the target, N", forces[1]),
    )
    cells = "".join(
        f'<tr><td style="opacity:.7;padding-right:10px">{name}</td><td><b>{value}</b></td></tr>'
        for name, value in rows
    )
    return f'<table style="font-size:12px;margin:4px 12px">{cells}</table>'
