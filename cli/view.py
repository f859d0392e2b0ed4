"""`gelgap view`: a page in the browser that shows one press live."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from gelgap import render, sim
from gelgap.assets.extras import need_extra
from gelgap.cli import options as opt


@dataclass(frozen=True)
class View(opt.Command):
    """Open a page in the browser: turn gel, contact and light, and see picture and force change at once.

    Only this machine can open the page, unless --host says otherwise. Ctrl-C ends it.

    For example:
      gelgap view
      gelgap view --sensor ball-pictures
      gelgap view --elastomer b1 --illumination i2 --port 9000 --no-browser
    """

    when_stopped = "the page is closed, and solved physics is kept"
    fills_cache = True

    elastomer: str = "e04"
    """Elastomer preset or TOML file to begin with."""
    illumination: opt.LightName = None
    """Illumination preset or TOML file to begin with."""
    sensor: str = "paper"
    """Sensor preset or TOML file to begin with; or a folder that calibrate has marked, to correct its presses."""
    port: Annotated[int, opt.between(0, 65535)] = 8080
    """Port of the page; 0 takes any free one."""
    host: str = "127.0.0.1"
    """Address that the page is served at; 0.0.0.0 lets the whole network turn the knobs."""
    no_browser: opt.Flag = False
    """Only print the address."""

    def run(self, started: float) -> None:
        """Serve the page until Ctrl-C."""
        need_extra("gelgap view", "view", "viser")
        import webbrowser

        from gelgap.view.marks import MarksPage
        from gelgap.view.page import Page
        from gelgap.view.state import Configuration

        page: MarksPage | Page
        if (folder := Path(self.sensor)).is_dir():
            page = MarksPage(folder, self.host, self.port)
        else:
            sensor = render.Sensor.named(self.sensor)
            gel = sim.Elastomer.named(self.elastomer)
            page = Page(Configuration(gel, sensor, sensor.lit_by(self.illumination)), self.host, self.port)
        try:
            print(f"open {page.address} in a browser; Ctrl-C ends it", flush=True)
            if not self.no_browser:
                webbrowser.open(page.address)
            page.wait()
        finally:
            page.close()
