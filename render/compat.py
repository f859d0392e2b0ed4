"""pyrender 0.1.45 on today's Python: picks OSMesa or EGL, and cures what keeps pyrender from importing.

pyrender pins PyOpenGL 3.1.0, which lacks `OSMesaCreateContextAttribs` and has a context pointer that cannot be hashed;
NumPy 2 lacks `np.infty`; and pyrender's viewer imports pyglet, which wants libGL that off-screen rendering never needs.
"""

import ctypes
import ctypes.util
import importlib
import os
import sys
import types

import numpy as np

PLATFORMS = ("osmesa", "egl")
INSTALL_HINT = (
    "install the system package libosmesa6 (Debian/Ubuntu: apt-get install libosmesa6), "
    "or libegl1 libegl-mesa0 libgl1-mesa-dri for EGL"
)


def _library(name: str) -> ctypes.CDLL | None:
    path = ctypes.util.find_library(name)
    if path is None:
        return None
    try:
        return ctypes.CDLL(path, mode=ctypes.RTLD_GLOBAL)
    except OSError:
        return None


def _initialised_platform() -> str | None:
    """Return the platform that this process has already fixed by importing OpenGL, or None."""
    module = sys.modules.get("OpenGL.platform")
    if module is None:
        return None
    return type(module.PLATFORM).__name__.removesuffix("Platform").lower()


def choose_platform() -> str:
    """Return "osmesa" or "egl": what this process already uses, else what PYOPENGL_PLATFORM asks for, else what works.

    Raises
    ------
    RuntimeError
        If the process has initialised another OpenGL platform, or neither library is installed.
    """
    initialised = _initialised_platform()
    if initialised is not None:
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
    wanted = (
        "neither OSMesa nor EGL" if requested is None else f"no library for PYOPENGL_PLATFORM={requested}"
    )
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
    constants = {
        "OSMESA_DEPTH_BITS": 0x30,
        "OSMESA_PROFILE": 0x33,
        "OSMESA_CORE_PROFILE": 0x34,
        "OSMESA_CONTEXT_MAJOR_VERSION": 0x36,
        "OSMESA_CONTEXT_MINOR_VERSION": 0x37,
    }
    for name, value in constants.items():
        setattr(osmesa, name, value)


def _prepare_egl() -> None:
    """Use Mesa's software rasteriser without a window system, and find OpenGL's functions where libGL is missing."""
    os.environ.setdefault("EGL_PLATFORM", "surfaceless")
    os.environ.setdefault("LIBGL_ALWAYS_SOFTWARE", "1")


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
        _prepare_egl()
    vars(np).setdefault("infty", np.inf)
    if "pyrender" not in sys.modules:
        viewer = types.ModuleType("pyrender.viewer")
        viewer.Viewer = None
        sys.modules["pyrender.viewer"] = viewer
    return importlib.import_module("pyrender"), platform
