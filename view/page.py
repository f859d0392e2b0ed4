"""The page: knobs, scene and figures, put together around the live model, which works in a thread of its own."""

import contextlib
import io
import socket
import threading
from collections.abc import Callable
from queue import SimpleQueue

import viser

from gelgap.assets.names import quoted
from gelgap.render.imaging import difference_picture
from gelgap.sim import Sphere
from gelgap.view.controls import Controls
from gelgap.view.panels import ComparePanel, Readout, narrow_html
from gelgap.view.saving import Files, add_savers, recipe_toml
from gelgap.view.scene3d import Scene3d
from gelgap.view.solver import Answer, Failed, Progress, SolvedAlone, SolvedLibrary, Solver
from gelgap.view.state import Configuration, LibraryRequest, LiveModel, Shown

_PICTURES_WIDTH_PX = 360
_KNOBS_WIDTH_PX = 330
# viser's camera turns with the arrow keys of the whole document, also those that a slider has taken.
_KEYS_STAY_WITH_SLIDERS = """<img src="data:," alt="" style="display:none" onerror="
window.gelgapKeys ||= (document.body.addEventListener('keydown', (event) => {
  if (event.target.closest('[role=slider], input')) event.stopPropagation();
}), true)">"""


# In a window too narrow for panels side by side, viser's one panel covers all but a strip of the scene.
_SCENE_STAYS_IN_VIEW = """<style>@media (max-width: 699px) {
  .mantine-Paper-root:has([role=tablist]) { width: 100% !important; max-height: 40% !important }
}</style>"""


class Page:
    """The page of a configuration, open until `close`; `address` is where a browser finds it.

    The model works in one thread of its own, on the newest configuration alone, so that no knob ever waits. Port 0
    takes any free one.

    Raises
    ------
    ValueError
        If the gel is too thin for a library, the port is taken, or the host is not this machine's.
    """

    def __init__(self, start: Configuration, host: str, port: int) -> None:
        start.library_keys()
        self._server = start_server(host, port)
        self.address = f"http://{host}:{self._server.get_port()}"
        self.shown: Shown | None = None
        """What the page shows now."""
        self._model = LiveModel()
        self._solver = Solver(lambda answer: self.do(lambda: self._take_in(answer)))
        self._tasks: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._lock = threading.Lock()
        self._wanted: Configuration | None = None
        self._failed: LibraryRequest | None = None
        self._build(start)
        self._want(start)
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def _build(self, start: Configuration) -> None:
        gui = self._server.gui
        gui.configure_theme(show_share_button=False, show_logo=False, brand_color=(32, 110, 150))
        pictures = gui.add_panel()
        with pictures.add_tab("What the camera sees"):
            self._readout = Readout(gui)
        pictures.dock_left()
        pictures.set_width(_PICTURES_WIDTH_PX)
        gui.add_html(_KEYS_STAY_WITH_SLIDERS + _SCENE_STAYS_IN_VIEW)
        self._scene = Scene3d(self._server, lambda number, place: self.controls.move_led(number, place))
        tabs = gui.add_tab_group()
        with tabs.add_tab("Turn"):
            self._narrow = gui.add_html("")
            self.controls = Controls(gui, start, self._want, lambda said: self._readout.say(said, bad=True))
        with tabs.add_tab("Compare"):
            self._compare = ComparePanel(gui, self._model.pictures)
        with tabs.add_tab("Save"):
            add_savers(gui, self._save)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_KNOBS_WIDTH_PX)
        self.controls.solve.on_click(lambda _: self._solve_pose())
        self._compare.keep.on_click(lambda _: self.do(self._keep_source))
        self._compare.swap.on_click(lambda _: self.do(self._swap))
        self._compare.recipe.on_click(lambda event: self._save(event.client, self._recipe))

    def do(self, task: Callable[[], None]) -> None:
        """Do something in the model's thread; what fails is said on the page."""
        self._tasks.put(task)

    def wait(self) -> None:
        """Wait until the page is closed."""
        while self._thread.is_alive():
            self._thread.join(1.0)

    def close(self) -> None:
        """End the page and the process that solves for it."""
        self._tasks.put(None)
        self._solver.close()
        self._thread.join(5.0)
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def _want(self, configuration: Configuration) -> None:
        with self._lock:
            self._wanted = configuration
        self.do(self._show_wanted)

    def _work(self) -> None:
        """Do tasks until the page is closed."""
        while (task := self._tasks.get()) is not None:
            try:
                task()
            except Exception as error:
                self._readout.say(str(error) or type(error).__name__, bad=True)

    def _show_wanted(self) -> None:
        """Show the newest configuration, unless an earlier task has done so."""
        with self._lock:
            wanted, self._wanted = self._wanted, None
        if wanted is not None:
            self._show(wanted)

    def _show(self, configuration: Configuration) -> None:
        request = self._model.lacks(configuration)
        if request is not None and request != self._failed:
            self._readout.say("solving this gel …")
            self._solver.request(request)
        shown = self.shown = self._model.show(configuration)
        reference = self._model.pictures.reference(configuration.lit, configuration.markers)
        colours = self._scene.show(shown, self.controls.colouring.value, self.controls.chosen_led)
        self._readout.show(shown, difference_picture(shown.picture, reference, 2.0), colours)
        self._narrow.content = narrow_html(shown, colours)
        if not self._wanted:
            self._compare.update(shown)

    def _solve_pose(self) -> None:
        self._readout.say("solving this very pose …")
        self._solver.request(self.controls.wanted.exact_pose)

    def _take_in(self, answer: Answer) -> None:
        """Take over an answer of the solving process."""
        match answer:
            case Progress(done=done, total=total):
                self._readout.show_progress(done, total)
            case Failed(request=request, reason=reason):
                self._readout.show_progress(1, 1)
                self._readout.say(f"the solve failed: {reason}", bad=True)
                self._failed = request if isinstance(request, LibraryRequest) else None
            case SolvedLibrary(request=request, result=library):
                self._model.add_library(request, library)
                self._show_solved()
            case SolvedAlone(request=request, result=pose):
                self._model.add_pose(request, pose)
                self._show_solved()

    def _show_solved(self) -> None:
        """Show what is wanted anew, now that more of it is solved."""
        self._readout.show_progress(1, 1)
        self._readout.say("")
        self._want(self._wanted or self.controls.wanted)

    def _keep_source(self) -> None:
        if self.shown is not None:
            self._compare.take(self.shown)
            self._compare.update(self.shown)

    def _swap(self) -> None:
        source = self._compare.source
        if source is not None:
            self._keep_source()
            self.controls.set_configuration(source.configuration)

    def _save(self, client: viser.ClientHandle | None, files_of: Callable[[Shown], Files]) -> None:
        """Send files of what is shown to the browser that asked for them."""

        def send() -> None:
            if client is not None and self.shown is not None:
                for name, content in files_of(self.shown).items():
                    client.send_file_download(name, content, save_immediately=True)

        self.do(send)

    def _recipe(self, target: Shown) -> Files:
        if self._compare.source is None:
            return {}
        content = recipe_toml(self._compare.source.configuration, target.configuration)
        pressed = "" if target.configuration.indenter == Sphere() else "--indenter NAME-OR-FILE "
        self._readout.say(f"saved gap.toml; make the data: gelgap generate gap.toml {pressed}--out data")
        return {"gap.toml": content}


def start_server(host: str, port: int) -> viser.ViserServer:
    """Start viser's server; port 0 takes any free one.

    Raises
    ------
    ValueError
        If the port is taken or the address is none of this machine: viser itself would silently take another port.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"--host = {quoted(host)}, --port = {port}: {reason}; choose others") from None
    # viser prints a table of addresses, and this program prints its own.
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="gelgap", verbose=False)
    if port and server.get_port() != port:
        server.stop()
        raise ValueError(f"--port = {port}: is taken by another program; choose another")
    return server
