"""pyrender as a geometry rasteriser: the deformed membrane in, rest coordinates of every pixel out.

pyrender makes the off-screen context (one per process), holds the mesh, compiles the shaders, computes the camera's
matrix and draws the mesh. Ours are the two shaders, the target, since pyrender's holds 8 bits and coordinates need 32,
and the vertex buffer, which is overwritten for each frame: pyrender would build its mesh anew. For that the methods
with an underscore that pyrender's own renderer calls are called here too; the version is pinned.

What is written does not depend on light, so one raster serves any number of illuminations and markers.

pyrender 0.1.45 pins PyOpenGL 3.1.0, which lacks `OSMesaCreateContextAttribs` and has a context pointer that cannot be
hashed; NumPy 2 lacks `np.infty`; and pyrender's viewer imports pyglet, which wants libGL that off-screen rendering
never needs. `import_pyrender` cures all of it.
"""

import ctypes
import ctypes.util
import importlib
import os
import sys
import threading
import types
from functools import lru_cache
from typing import Any

import numpy as np

from gelgap.assets import asset_path
from gelgap.assets.pinhole import Pinhole
from gelgap.render.surface import Lattice

PLATFORMS = ("osmesa", "egl")
INSTALL_HINT = (
    "install the system package libosmesa6 (Debian/Ubuntu: apt-get install libosmesa6), "
    "or libegl1 libegl-mesa0 libgl1-mesa-dri for EGL"
)
# Renderers in several threads share rasterisers. No thread draws while its process forks: the child would wait for it.
LOCK = threading.RLock()
os.register_at_fork(before=LOCK.acquire, after_in_parent=LOCK.release, after_in_child=LOCK.release)
_CACHED_RASTERIZERS = 8
# What stands in pixels that do not see the membrane.
NOWHERE_MM = 1e6


def _library(name: str) -> ctypes.CDLL | None:
    path = ctypes.util.find_library(name)
    if path is None:
        return None
    try:
        return ctypes.CDLL(path, mode=ctypes.RTLD_GLOBAL)
    except OSError:
        return None


def choose_platform() -> str:
    """Return "osmesa" or "egl": what this process already uses, else what PYOPENGL_PLATFORM asks for, else what works.

    Raises
    ------
    RuntimeError
        If the process has initialised another OpenGL platform, or neither library is installed.
    """
    if (module := sys.modules.get("OpenGL.platform")) is not None:
        initialised = type(module.PLATFORM).__name__.removesuffix("Platform").lower()
        if initialised not in PLATFORMS:
            raise RuntimeError(
                f"OpenGL was already initialised for the platform {initialised!r} in this process, and rendering needs "
                "'osmesa' or 'egl'; render before the other OpenGL user is imported, in another process, or start "
                "Python with PYOPENGL_PLATFORM=osmesa"
            )
        return initialised
    requested = os.environ.get("PYOPENGL_PLATFORM")
    if requested is not None and requested not in PLATFORMS:
        raise RuntimeError(
            f"PYOPENGL_PLATFORM is {requested!r}, and rendering needs 'osmesa' or 'egl'; unset it or set "
            "PYOPENGL_PLATFORM=osmesa"
        )
    for platform, library in (("osmesa", "OSMesa"), ("egl", "EGL")):
        if requested in (None, platform) and _library(library) is not None:
            return platform
    wanted = f"no library for PYOPENGL_PLATFORM={requested}" if requested else "neither OSMesa nor EGL"
    raise RuntimeError(f"{wanted} was found, so nothing can be rendered; {INSTALL_HINT}")


def _add_osmesa_context_attributes() -> None:
    """Give PyOpenGL < 3.1.4 the call that makes an OpenGL 3.3 context, and a context pointer that can be hashed."""
    import OpenGL.osmesa as osmesa
    import OpenGL.platform
    from OpenGL.raw.osmesa import _types

    if hasattr(osmesa, "OSMesaCreateContextAttribs"):
        return
    pointer_type = _types.OSMesaContext
    # By address: else every look-up of the current context is a new key, pyrender compiles its shaders anew for each
    # frame, and neither they nor the arrays that PyOpenGL keeps for a context are ever freed.
    pointer_type.__hash__ = lambda self: hash(self.address)
    pointer_type.__eq__ = lambda self, other: (
        isinstance(other, pointer_type) and self.address == other.address
    )
    create = OpenGL.platform.PLATFORM.OSMesa.OSMesaCreateContextAttribs
    create.restype = pointer_type
    create.argtypes = [ctypes.c_void_p, pointer_type]

    def create_context_attributes(attributes, share=None):
        values = np.ascontiguousarray(attributes, np.int32)
        return create(values.ctypes.data, share)

    osmesa.OSMesaCreateContextAttribs = create_context_attributes
    osmesa.OSMESA_DEPTH_BITS, osmesa.OSMESA_PROFILE, osmesa.OSMESA_CORE_PROFILE = 0x30, 0x33, 0x34
    osmesa.OSMESA_CONTEXT_MAJOR_VERSION, osmesa.OSMESA_CONTEXT_MINOR_VERSION = 0x36, 0x37


def import_pyrender() -> tuple[types.ModuleType, str]:
    """Import pyrender and return it with the platform that it renders on.

    Raises
    ------
    RuntimeError
        If no usable OpenGL platform is there (see `choose_platform`).
    """
    platform = choose_platform()
    os.environ["PYOPENGL_PLATFORM"] = platform
    # The calling thread rasterises: the same bytes on any machine, and a forked worker never waits for a lost thread.
    os.environ.setdefault("LP_NUM_THREADS", "0")
    if platform == "osmesa":
        _add_osmesa_context_attributes()
    else:
        # Mesa's software rasteriser, without a window system.
        os.environ.setdefault("EGL_PLATFORM", "surfaceless")
        os.environ.setdefault("LIBGL_ALWAYS_SOFTWARE", "1")
    vars(np).setdefault("infty", np.inf)
    viewer = types.ModuleType("pyrender.viewer")
    vars(viewer)["Viewer"] = None
    sys.modules.setdefault("pyrender.viewer", viewer)
    return importlib.import_module("pyrender"), platform


@lru_cache(maxsize=1)
def _context(process_id: int) -> Any:
    """Return this process's off-screen context; a forked child makes its own."""
    _, platform = import_pyrender()
    if platform == "osmesa":
        from pyrender.platforms.osmesa import OSMesaPlatform as Platform
    else:
        from pyrender.platforms.egl import EGLPlatform as Platform
    context = Platform(16, 16)
    try:
        context.init_context()
        context.make_current()
    except Exception as error:
        raise RuntimeError(
            f"the {platform} platform could not make an OpenGL 3.3 context: {error}"
        ) from error
    return context


def _grid_triangles(rows: int, columns: int) -> np.ndarray:
    """Return (2(rows−1)(columns−1), 3) vertex indices of a row-major grid, with alternating diagonals."""
    index = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    row, column = np.indices(a.shape)
    even = ((row + column) % 2 == 0)[..., None]
    first = np.where(even, np.stack([a, b, c], -1), np.stack([a, b, d], -1))
    second = np.where(even, np.stack([a, c, d], -1), np.stack([b, c, d], -1))
    # Neighbours follow one another, so that their vertices are transformed once.
    return np.stack([first, second], axis=-2).reshape(-1, 3)


class Rasterizer:
    """Rasterises one grid topology through one camera into a float32 picture of rest coordinates."""

    def __init__(self, camera: Pinhole, lattice: Lattice, size_px: tuple[int, int]) -> None:
        pyrender, _ = import_pyrender()
        from OpenGL import GL
        from pyrender.renderer import Renderer

        self._gl = GL
        self._context = _context(os.getpid())
        self._context.make_current()
        self._size_px = size_px
        self._geometry = np.zeros((size_px[1], size_px[0], 2), np.float32)
        self._rastered_mm: np.ndarray | None = None
        rest_mm = lattice.points_mm().astype(np.float32).reshape(-1, 2)
        self._vertices = np.zeros((len(rest_mm), 5), np.float32)  # position and rest coordinates
        self._vertices[:, 3:] = rest_mm
        self._mesh = pyrender.Primitive(
            positions=self._vertices[:, :3].copy(),
            texcoord_0=rest_mm,
            indices=_grid_triangles(lattice.rows, lattice.columns),
            mode=pyrender.GLTF.TRIANGLES,
            material=pyrender.MetallicRoughnessMaterial(doubleSided=True),
        )
        self._mesh._add_to_context()
        self._vertex_buffer = self._mesh._buffers[0]
        self._program = _program(camera, size_px)
        self._flags = pyrender.RenderFlags.NONE
        self._renderer = Renderer(*size_px)
        self._framebuffer, self._renderbuffers = self._float_framebuffer(*size_px)

    def _float_framebuffer(self, width: int, height: int) -> tuple[int, np.ndarray]:
        gl = self._gl
        framebuffer = gl.glGenFramebuffers(1)
        buffers = gl.glGenRenderbuffers(2)
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, framebuffer)
        formats = ((gl.GL_RG32F, gl.GL_COLOR_ATTACHMENT0), (gl.GL_DEPTH_COMPONENT32F, gl.GL_DEPTH_ATTACHMENT))
        for buffer, (storage, attachment) in zip(buffers, formats, strict=True):
            gl.glBindRenderbuffer(gl.GL_RENDERBUFFER, buffer)
            gl.glRenderbufferStorage(gl.GL_RENDERBUFFER, storage, width, height)
            gl.glFramebufferRenderbuffer(gl.GL_FRAMEBUFFER, attachment, gl.GL_RENDERBUFFER, buffer)
        if gl.glCheckFramebufferStatus(gl.GL_FRAMEBUFFER) != gl.GL_FRAMEBUFFER_COMPLETE:
            raise RuntimeError(f"this OpenGL cannot render to a {width}×{height} float buffer")
        return framebuffer, buffers

    def geometry(self, positions_mm: np.ndarray) -> np.ndarray:
        """Return (h, w, 2) float32: rest x and y in mm of the membrane in each pixel; `NOWHERE_MM` where it is not.

        `positions_mm` is (rows, columns, 3) float32. The result is overwritten by the next call, so that the caller
        holds `LOCK` until it is read; the same positions again are not rastered again.
        """
        if self._rastered_mm is None or not np.array_equal(self._rastered_mm, positions_mm):
            self._vertices[:, :3] = positions_mm.reshape(-1, 3)
            self._draw()
            self._rastered_mm = positions_mm.copy()
        return self._geometry[::-1]

    def _draw(self) -> None:
        gl = self._gl
        self._context.make_current()
        gl.glBindBuffer(gl.GL_ARRAY_BUFFER, self._vertex_buffer)
        gl.glBufferSubData(gl.GL_ARRAY_BUFFER, 0, self._vertices.nbytes, self._vertices)
        gl.glBindFramebuffer(gl.GL_FRAMEBUFFER, self._framebuffer)
        gl.glViewport(0, 0, *self._size_px)
        gl.glClearColor(NOWHERE_MM, NOWHERE_MM, 0.0, 0.0)
        gl.glEnable(gl.GL_DEPTH_TEST)
        gl.glClear(gl.GL_COLOR_BUFFER_BIT | gl.GL_DEPTH_BUFFER_BIT)
        self._program._bind()
        self._renderer._bind_and_draw_primitive(self._mesh, np.eye(4), self._program, self._flags)
        self._program._unbind()
        gl.glReadPixels(0, 0, *self._size_px, gl.GL_RG, gl.GL_FLOAT, self._geometry)

    def delete(self) -> None:
        """Free what this rasteriser holds in the OpenGL context."""
        gl = self._gl
        self._context.make_current()
        self._mesh.delete()
        self._program.delete()
        self._renderer.delete()
        gl.glDeleteFramebuffers(1, [self._framebuffer])
        gl.glDeleteRenderbuffers(2, self._renderbuffers)


def _program(camera: Pinhole, size_px: tuple[int, int]) -> Any:
    """Return the shaders of `assets/shaders`, compiled, with a camera's matrices and lens."""
    from pyrender import IntrinsicsCamera
    from pyrender.shader_program import ShaderProgram

    width, height = size_px
    focal_px = camera.focal_length_px(width)
    distance_mm = -camera.position_mm[2]
    near_mm, far_mm = 0.1 * distance_mm, 3 * distance_mm
    projection = IntrinsicsCamera(focal_px, focal_px, width / 2, height / 2, znear=near_mm, zfar=far_mm)
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = camera.position_mm
    folder = asset_path("shaders")
    program = ShaderProgram(str(folder / "mesh.vert"), str(folder / "mesh.frag"))
    program._add_to_context()
    program._bind()
    program.set_uniform("V", np.linalg.inv(pose))
    program.set_uniform("P", projection.get_projection_matrix(width=width, height=height))
    program.set_uniform("radial_distortion", np.asarray(camera.radial_distortion, np.float32))
    program.set_uniform("farthest_slope", camera.farthest_slope(size_px))
    program._unbind()
    return program


# By process, camera, grid and picture size.
_rasterizers: dict[tuple[int, Pinhole, Lattice, tuple[int, int]], Rasterizer] = {}


def rasterizer_for(camera: Pinhole, lattice: Lattice, size_px: tuple[int, int]) -> Rasterizer:
    """Return this process's rasteriser for a camera, grid and picture size; a few are kept, the oldest is freed."""
    key = (os.getpid(), camera, lattice, size_px)
    with LOCK:
        if key not in _rasterizers:
            for other in [other for other in _rasterizers if other[0] != os.getpid()]:
                del _rasterizers[other]  # belongs to the parent's context: never touch it from here
            if len(_rasterizers) >= _CACHED_RASTERIZERS:
                _rasterizers.pop(next(iter(_rasterizers))).delete()
            _rasterizers[key] = Rasterizer(camera, lattice, size_px)
        return _rasterizers[key]
