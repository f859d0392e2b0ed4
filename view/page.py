"""The page: knobs, scene and figures, put together around the live model."""

import contextlib
import io
import threading
from collections import deque
from collections.abc import Callable

from gelgap.view.comparing import ComparePanel
from gelgap.view.configuration import Configuration
from gelgap.view.controls import Controls
from gelgap.view.data_panel import DataPanel
from gelgap.view.live import LiveModel, Shown
from gelgap.view.pictures import difference
from gelgap.view.readout import Readout
from gelgap.view.requests import Answer, Failed, PathRequest, PoseRequest, Progress, Solved
from gelgap.view.save_panel import SavePanel
from gelgap.view.scene3d import Scene3d, colours_mean
from gelgap.view.server import start_server
from gelgap.view.solver import Solver

_PICTURES_WIDTH_PX = 360
_KNOBS_WIDTH_PX = 330


class Page:
    """A page that is open until `close`; `address` is where a browser finds it.

    The model works in one thread of its own, on the newest configuration alone, so that no knob ever waits.
    """

    def __init__(
        self,
        start: Configuration,
        host: str,
        port: int,
        make_solver: Callable[[Callable[[Answer], None]], Solver] = Solver,
    ) -> None:
        start.path_keys()
        self._server = start_server(host, port)
        self.address = f"http://{host}:{self._server.get_port()}"
        self._model = LiveModel()
        self._solver = make_solver(self._hear)
        self._condition = threading.Condition()
        self._wanted: Configuration | None = start
        self._tasks: deque[Callable[[], None]] = deque()
        self._closed = False
        self._failed: PathRequest | None = None
        self._shown: Shown | None = None
        self._build(start)
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
        self._scene = Scene3d(self._server, lambda number, place: self.controls.move_led(number, place))
        tabs = gui.add_tab_group()
        with tabs.add_tab("Turn"):
            self.controls = Controls(gui, start, self._want, lambda said: self._readout.say(said, bad=True))
        with tabs.add_tab("Compare"):
            self._compare = ComparePanel(gui, self)
        with tabs.add_tab("Save"):
            self._save = SavePanel(gui, self)
        with tabs.add_tab("Data"):
            self._data = DataPanel(gui)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_KNOBS_WIDTH_PX)
        self.controls.solve.on_click(lambda _: self._solve_pose())

    @property
    def shown(self) -> Shown | None:
        """What the page shows now."""
        return self._shown

    @property
    def model(self) -> LiveModel:
        return self._model

    def do(self, task: Callable[[], None]) -> None:
        """Do something in the model's thread; what fails is said on the page."""
        with self._condition:
            self._tasks.append(task)
            self._condition.notify()

    def say(self, sentence: str, bad: bool = False) -> None:
        """Say a sentence below the figures."""
        self._readout.say(sentence, bad)

    def wait(self) -> None:
        """Wait until the page is closed."""
        while not self._closed:
            self._thread.join(1.0)

    def close(self) -> None:
        """End the page and the process that solves for it."""
        with self._condition:
            self._closed = True
            self._condition.notify()
        self._solver.close()
        self._thread.join(5.0)
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def _want(self, configuration: Configuration) -> None:
        with self._condition:
            self._wanted = configuration
            self._condition.notify()

    def _solve_pose(self) -> None:
        self._readout.say("solving this very pose …")
        self._solver.request(PoseRequest.of(self.controls.wanted))

    def _hear(self, answer: Answer) -> None:
        """Take an answer of the solving process over into the model's thread."""
        self.do(lambda: self._take_in(answer))

    def _take_in(self, answer: Answer) -> None:
        match answer:
            case Progress(done=done, total=total):
                self._readout.show_progress(done, total)
            case Failed(request=request, reason=reason):
                self._readout.show_progress(1, 1)
                self._readout.say(f"the solve failed: {reason}", bad=True)
                self._failed = request if isinstance(request, PathRequest) else None
            case Solved(request=request, result=result):
                self._readout.show_progress(1, 1)
                self._readout.say("")
                if isinstance(request, PathRequest):
                    self._model.add_path(request, result)
                else:
                    self._model.add_pose(request, result)
                self._wanted = self._wanted or self.controls.wanted

    def _work(self) -> None:
        """Do tasks and show the newest configuration, until the page is closed."""
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._closed or self._tasks or self._wanted is not None)
                if self._closed:
                    return
                task = self._tasks.popleft() if self._tasks else None
                wanted = None
                if task is None:
                    wanted, self._wanted = self._wanted, None
            try:
                if task is not None:
                    task()
                else:
                    self._show(wanted)
            except Exception as error:
                self._readout.say(str(error) or type(error).__name__, bad=True)

    def _show(self, configuration: Configuration) -> None:
        request = self._model.lacks(configuration)
        if request is not None and request != self._failed:
            self._readout.say("solving the path of this gel …")
            self._solver.request(request)
        shown = self._shown = self._model.show(configuration)
        reference = self._model.pictures.reference(configuration)
        colouring = self.controls.colouring.value
        self._readout.show(shown, difference(shown.picture, reference), colours_mean(shown, colouring))
        self._scene.show(shown, colouring)
        self._scene.show_leds(configuration.illumination, self.controls.chosen_led)
        if not self._wanted:
            self._compare.update(shown)
