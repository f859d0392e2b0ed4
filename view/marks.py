"""The page of a folder's marks: each press with its circle, which is dragged or typed until it is right, and saved."""

import contextlib
import io
import threading
from pathlib import Path

import numpy as np
import viser

from gelgap.assets.image_file import read_image
from gelgap.domains.press_folder import LIST, save_press_list
from gelgap.render import difference_picture
from gelgap.render.calibration.pictures import ListedPress, read_press_list
from gelgap.view.panels import sentence_html
from gelgap.view.page import start_server

# The picture lies in the plane z = 0 of the scene, this wide, its difference to the reference to the right of it.
_WIDTH, _GAP, _HANDLE = 10.0, 0.3, 1.2
_CIRCLE, _GAIN = (255, 255, 0), 2.0
_HELP = (
    "Drag the handle to where the ball touches; the circle lies **inside** the dent. Right: 128 + 2 × the difference "
    "to the picture without contact."
)


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
        for number, press in enumerate(self._listed.presses, start=1):
            if press.picture is None or press.center_px is None or press.radius_px is None:
                raise ValueError(f"{path}: press {number} ({press.label}) must have picture, center_px and radius_px")
        if not self._listed.presses or self._listed.reference is None:
            raise ValueError(f"{path} must have reference and presses")
        self._reference = read_image(folder / self._listed.reference)
        self._pictures = {press.picture: read_image(folder / press.picture) for press in self._listed.presses}
        self.presses: dict[str, ListedPress] = {press.picture: press for press in self._listed.presses}
        self.left_out: set[str] = set()
        self._lock, self._closed, self._filling = threading.RLock(), threading.Event(), False
        self._server = start_server(host, port)
        self.address = f"http://{host}:{self._server.get_port()}"
        self._build()
        self._show()

    def _build(self) -> None:
        gui, scene = self._server.gui, self._server.scene
        height, width, _ = self._reference.shape
        self._unit = _WIDTH / width
        gui.configure_theme(show_share_button=False, show_logo=False, brand_color=(32, 110, 150))
        gui.add_markdown(_HELP)
        self.press = gui.add_dropdown("press", tuple(self.presses))
        following = gui.add_button("Next")
        self.x = gui.add_slider("centre x, px", -0.5 * width, 1.5 * width, 0.1, 0.0)
        self.y = gui.add_slider("centre y, px", -0.5 * height, 1.5 * height, 0.1, 0.0)
        self.radius = gui.add_slider("radius, px", 2.0, float(max(width, height)), 0.1, 2.0)
        self.used = gui.add_checkbox("use this press", True)
        self.save = gui.add_button(f"Save {LIST}")
        self._message = gui.add_html("")
        scene.set_up_direction("-y")
        self._server.initial_camera.position = (0.5 * (_WIDTH + _GAP), 0.0, -2.2 * _WIDTH)
        self._server.initial_camera.look_at = (0.5 * (_WIDTH + _GAP), 0.0, 0.0)
        size = {"render_width": _WIDTH, "render_height": height * self._unit, "cast_shadow": False}
        self._images = [
            scene.add_image(name, self._reference, format="png", position=(at, 0.0, 0.0), **size)
            for name, at in (("/picture", 0.0), ("/difference", _WIDTH + _GAP))
        ]
        self._handle = scene.add_transform_controls(
            "/mark", _HANDLE, active_axes=(True, True, False), disable_rotations=True, depth_test=False
        )
        self.press.on_update(lambda _: self._show())
        following.on_click(lambda _: self._go_on())
        for knob in (self.x, self.y, self.radius, self.used):
            knob.on_update(lambda _: self._take())
        self._handle.on_update(lambda _: self._drag())
        self.save.on_click(lambda _: self._save())

    def _go_on(self) -> None:
        names = list(self.presses)
        self.press.value = names[(names.index(self.press.value) + 1) % len(names)]

    def _show(self) -> None:
        """Turn all knobs to the chosen press."""
        with self._lock:
            chosen = self.presses[self.press.value]
            self._filling = True
            (self.x.value, self.y.value), self.radius.value = chosen.center_px, chosen.radius_px
            self.used.value = chosen.picture not in self.left_out
            self._filling = False
            self._draw()

    def _take(self) -> None:
        """Take over what a knob says."""
        with self._lock:
            if self._filling:
                return
            name, center_px = self.press.value, (self.x.value, self.y.value)
            moved = {"center_px": center_px, "radius_px": self.radius.value}
            self.presses[name] = self.presses[name].model_copy(update=moved)
            self.left_out = self.left_out - {name} if self.used.value else self.left_out | {name}
            self._draw()

    def _drag(self) -> None:
        """Move the mark to where the handle is."""
        height, width, _ = self._reference.shape
        center_px = self._handle.position[:2] / self._unit + (width / 2 - 0.5, height / 2 - 0.5)
        with self._lock:
            self._filling = True
            self.x.value, self.y.value = (round(float(value), 1) for value in center_px)
            self._filling = False
            self._take()

    def _draw(self) -> None:
        import cv2

        name = self.press.value
        (x, y), radius = self.presses[name].center_px, self.presses[name].radius_px
        picture, sixteenths = self._pictures[name], 16
        changed = difference_picture(picture, self._reference, _GAIN)
        for image, shown in zip(self._images, (picture, changed), strict=True):
            at = round(x * sixteenths), round(y * sixteenths)
            marked = cv2.circle(shown.copy(), at, round(radius * sixteenths), _CIRCLE, 1, cv2.LINE_AA, 4)
            image.image = marked
        height, width, _ = picture.shape
        place = (self._unit * (x + 0.5 - width / 2), self._unit * (y + 0.5 - height / 2), 0.0)
        if not np.allclose(self._handle.position, place, atol=0.2 * self._unit):
            self._handle.position = place

    def _save(self) -> None:
        with self._lock:
            used = tuple(press for name, press in self.presses.items() if name not in self.left_out)
            save_press_list(self._listed.model_copy(update={"presses": used}), self._path)
            said = f"saved {len(used)} presses; fit them: gelgap calibrate {self._path}"
            self._message.content = sentence_html(said, bad=False)

    def wait(self) -> None:
        """Wait until the page is closed."""
        while not self._closed.wait(1.0):
            pass

    def close(self) -> None:
        """End the page."""
        self._closed.set()
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
