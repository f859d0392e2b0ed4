"""The page of a folder's marks: each press with its circle, which is dragged or typed until it is right, and saved."""

import contextlib
import io
import threading
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gelgap.assets.image_file import SHEET, read_image
from gelgap.calibrate.pictures import ListedPress, read_press_list
from gelgap.calibrate.press_folder import LIST, save_marks
from gelgap.render.imaging import difference_picture
from gelgap.view.page import start_server
from gelgap.view.panels import sentence_html, set_value

# The picture lies in the plane z = 0 of the scene, this wide, its difference to the reference to the right of it.
_WIDTH, _GAP, _HANDLE = 10.0, 0.3, 1.2
_CIRCLE, _GAIN, _SIXTEENTHS = (255, 255, 0), 2.0, 16
_HELP = (
    "Drag the handle to where the ball touches; the circle lies **inside** the dent. Right: 128 + 2 × the difference "
    "to the picture without contact."
)


@dataclass(frozen=True)
class _Mark:
    """A press as it is listed, and its circle as it is now."""

    press: ListedPress
    center_px: tuple[float, float]
    radius_px: float
    used: bool = True


class MarksPage:
    """A page that is open until `close`; `address` is where a browser finds it.

    Raises
    ------
    FileNotFoundError
        If the folder has no list of presses.
    ValueError
        If its list is not one of balls marked by centre and radius, or the port is taken.
    """

    def __init__(self, folder: Path, host: str, port: int) -> None:
        if not (path := folder / LIST).is_file():
            raise FileNotFoundError(f"{path} does not exist; first: gelgap calibrate {folder} …")
        self._path, self._listed = path, read_press_list(path)
        if not self._listed.presses or self._listed.reference is None:
            raise ValueError(f"{path} must have reference and presses")
        self._marks: dict[str, _Mark] = {}
        for number, press in enumerate(self._listed.presses, start=1):
            if press.picture is None or press.center_px is None or press.radius_px is None:
                raise ValueError(
                    f"{path}: press {number} ({press.label}) must have picture, center_px and radius_px"
                )
            if press.picture in self._marks:
                raise ValueError(f"{path}: a picture is listed twice, and this page holds one circle of each")
            self._marks[press.picture] = _Mark(press, press.center_px, press.radius_px)
        files = (self._listed.reference, *self._marks)
        self._pictures = {file: read_image(folder / file) for file in files}
        self._reference = self._pictures[self._listed.reference]
        self._lock, self._closed, self._filling = threading.RLock(), threading.Event(), False
        self._server = start_server(host, port)
        self.address = f"http://{host}:{self._server.get_port()}"
        self._build()
        self._show()

    def _build(self) -> None:
        gui, scene, (height, width, _) = self._server.gui, self._server.scene, self._reference.shape
        self._unit = _WIDTH / width
        self._corner_px = np.array([width, height]) / 2 - 0.5
        gui.add_markdown(_HELP)
        self.press = gui.add_dropdown("press", tuple(self._marks))
        self.x = gui.add_slider("centre x, px", -0.5 * width, 1.5 * width, 0.1, 0.0)
        self.y = gui.add_slider("centre y, px", -0.5 * height, 1.5 * height, 0.1, 0.0)
        self.radius = gui.add_slider("radius, px", 2.0, float(max(width, height)), 0.1, 2.0)
        self.used = gui.add_checkbox("use this press", True)
        self.save = gui.add_button(f"Save {LIST}")
        self._message = gui.add_html("")
        scene.set_up_direction("-y")
        middle = (_WIDTH + _GAP) / 2
        self._server.initial_camera.position = (middle, 0.0, -1.4 * _WIDTH)
        self._server.initial_camera.look_at = (middle, 0.0, 0.0)
        size = {"render_width": _WIDTH, "render_height": height * self._unit, "cast_shadow": False}
        self._images = [
            scene.add_image(name, self._reference, format="png", position=(at, 0.0, 0.0), **size)
            for name, at in (("/picture", 0.0), ("/difference", _WIDTH + _GAP))
        ]
        self.handle = scene.add_transform_controls(
            "/mark", _HANDLE, active_axes=(True, True, False), disable_rotations=True, depth_test=False
        )
        self.press.on_update(lambda _: self._show())
        for knob in (self.x, self.y, self.radius, self.used):
            knob.on_update(lambda _: self._take())
        self.handle.on_update(lambda _: self.drag())
        self.save.on_click(lambda _: self.save_list())

    def _show(self) -> None:
        """Turn all knobs to the chosen press."""
        with self._lock:
            mark = self._marks[self.press.value]
            self._filling = True
            self._set_centre(*mark.center_px)
            set_value(self.radius, mark.radius_px)
            set_value(self.used, mark.used)
            self._filling = False
            self._draw()

    def drag(self) -> None:
        """Move the mark to where the handle is."""
        with self._lock:
            self._filling = True
            self._set_centre(*(self.handle.position[:2] / self._unit + self._corner_px).round(1).tolist())
            self._filling = False
            self._take()

    def _set_centre(self, x_px: float, y_px: float) -> None:
        set_value(self.x, x_px)
        set_value(self.y, y_px)

    def _take(self) -> None:
        """Take over what the knobs say."""
        with self._lock:
            if self._filling:
                return
            name = self.press.value
            self._marks[name] = replace(
                self._marks[name],
                center_px=(self.x.value, self.y.value),
                radius_px=self.radius.value,
                used=self.used.value,
            )
            self._draw()

    def _draw(self) -> None:
        import cv2

        mark, picture = self._marks[self.press.value], self._pictures[self.press.value]
        x, y, radius = (round(_SIXTEENTHS * value) for value in (*mark.center_px, mark.radius_px))
        shown = picture, difference_picture(picture, self._reference, _GAIN)
        for image, pixels in zip(self._images, shown, strict=True):
            image.image = cv2.circle(pixels.copy(), (x, y), radius, _CIRCLE, 1, cv2.LINE_AA, 4)
        place = np.append(self._unit * (np.array(mark.center_px) - self._corner_px), 0.0)
        if not np.allclose(self.handle.position, place, atol=0.2 * self._unit):  # else it is being dragged
            self.handle.position = place

    def save_list(self) -> None:
        """Write list and sheet anew, without the presses that are not used."""
        with self._lock:
            used = tuple(
                mark.press.model_copy(update={"center_px": mark.center_px, "radius_px": mark.radius_px})
                for mark in self._marks.values()
                if mark.used
            )
            save_marks(self._listed.model_copy(update={"presses": used}), self._path, self._pictures)
            said = f"saved {len(used)} presses, and {SHEET}; fit them: gelgap calibrate {self._path}"
            self._message.content = sentence_html(said, bad=False)

    def wait(self) -> None:
        """Wait until the page is closed."""
        self._closed.wait()

    def close(self) -> None:
        """End the page."""
        self._closed.set()
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
