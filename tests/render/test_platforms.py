"""OSMesa and EGL draw the same picture; a process that cannot render says why."""

import os
import subprocess
import sys

import numpy as np
import pytest

RENDER = """
import sys
import numpy as np
from gelgap.render.light.leds import Illumination
from gelgap.render.renderer import MembraneRenderer
from gelgap.render.sensor import Sensor

x, y = np.linspace(-7, 7, 141), np.linspace(-5.5, 5.5, 111)
dent = 0.6 * np.exp(-(np.add.outer(y**2, x**2)))
u = np.stack([0.2 * dent, 0 * dent, -dent], axis=-1)
renderer = MembraneRenderer(Sensor.preset("paper"), Illumination.preset("i0"), (160, 120))
np.save(sys.argv[1], renderer.picture(x, y, u))
"""


def run(code, *arguments, **environment):
    keep = {key: value for key, value in os.environ.items() if key != "PYOPENGL_PLATFORM"}
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(
        command, env=keep | environment, capture_output=True, text=True, timeout=120, check=False
    )


def test_osmesa_and_egl_give_the_same_picture(tmp_path):
    pictures = []
    for platform in ("osmesa", "egl"):
        result = run(RENDER, tmp_path / f"{platform}.npy", PYOPENGL_PLATFORM=platform)
        if platform == "egl" and "was found" in result.stderr:
            pytest.skip("EGL is not installed")
        assert result.returncode == 0, result.stderr
        pictures.append(np.load(tmp_path / f"{platform}.npy").astype(int))
    assert np.abs(pictures[0] - pictures[1]).max() <= 1


def test_an_unusable_platform_is_named():
    result = run(
        "from gelgap.render.rasterizer import choose_platform; choose_platform()", PYOPENGL_PLATFORM="glx"
    )
    assert "PYOPENGL_PLATFORM is 'glx'" in result.stderr
    assert "osmesa" in result.stderr


def test_another_initialised_platform_is_a_clear_error():
    code = """
import sys, types
class GLXPlatform: pass
module = types.ModuleType("OpenGL.platform")
module.PLATFORM = GLXPlatform()
sys.modules["OpenGL.platform"] = module
from gelgap.render.rasterizer import choose_platform
choose_platform()
"""
    result = run(code)
    assert "already initialised for the platform 'glx'" in result.stderr


def test_missing_libraries_are_named_and_egl_is_the_fallback():
    code = """
from gelgap.render import rasterizer
have = set()
rasterizer._library = lambda name: name in have or None
have.add("EGL")
print(rasterizer.choose_platform())
have.clear()
rasterizer.choose_platform()
"""
    result = run(code)
    assert result.stdout.strip() == "egl"
    assert "libosmesa6" in result.stderr


def test_pyrender_finds_what_this_numpy_lacks():
    code = """
from gelgap.render.rasterizer import import_pyrender
pyrender, _ = import_pyrender()
print(pyrender.Mesh([]).bounds.shape)
"""
    assert run(code).stdout.strip() == "(2, 3)"


def test_rendering_modules_import_no_heavy_package():
    code = """
import sys
import gelgap.render.sensor, gelgap.render.light.leds, gelgap.data.inpainting, gelgap.render.imaging
heavy = {"pyrender", "colour", "cv2", "torch", "mujoco", "matplotlib", "skimage"} & set(sys.modules)
assert not heavy, heavy
"""
    assert run(code).returncode == 0, run(code).stderr
