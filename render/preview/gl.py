"""An OpenGL 3.3 core context without a display: OSMesa first, EGL where OSMesa is missing.

moderngl ships no OSMesa back end, so a small adapter over the C library is handed to it. Mesa
dropped OSMesa in version 25.1; EGL is the fallback and uses a GPU where there is one.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib
import os
import shutil
from pathlib import Path
from typing import Any

from render.errors import GraphicsError
from render.memory import PREVIEW, require_memory

BACKENDS = ("osmesa", "egl")
VARIABLE = "TACTILUX_GL"
"""Environment variable that forces one back end."""

SHADER_ROOM = 1 << 30
"""Free bytes of a disk from which on compiled shaders are kept there; they are some 10^5."""

# Constants of GL/osmesa.h.
_OSMESA_RGBA = 0x1908
_OSMESA_FORMAT, _OSMESA_DEPTH_BITS, _OSMESA_STENCIL_BITS = 0x22, 0x30, 0x31
_OSMESA_PROFILE, _OSMESA_CORE_PROFILE = 0x33, 0x34
_OSMESA_CONTEXT_MAJOR_VERSION, _OSMESA_CONTEXT_MINOR_VERSION = 0x36, 0x37
_GL_UNSIGNED_BYTE = 0x1401


class OSMesa:
    """One off-screen Mesa context in the form that ``moderngl.create_context`` accepts."""

    def __init__(self, library: str | None = None) -> None:
        """Load libOSMesa and create a core profile 3.3 context.

        Raises:
            OSError: when there is no such library or it refuses the context.
        """
        name = library or ctypes.util.find_library("OSMesa") or "libOSMesa.so.8"
        self._library = ctypes.CDLL(name)
        self._library.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
        self._library.OSMesaCreateContextAttribs.argtypes = (ctypes.c_void_p, ctypes.c_void_p)
        self._library.OSMesaGetProcAddress.restype = ctypes.c_void_p
        self._library.OSMesaGetProcAddress.argtypes = (ctypes.c_char_p,)
        self._library.OSMesaMakeCurrent.argtypes = (
            ctypes.c_void_p,
            ctypes.c_void_p,
            *(ctypes.c_uint, ctypes.c_int, ctypes.c_int),
        )
        self._library.OSMesaDestroyContext.argtypes = (ctypes.c_void_p,)
        wanted = (
            *(_OSMESA_FORMAT, _OSMESA_RGBA, _OSMESA_DEPTH_BITS, 0, _OSMESA_STENCIL_BITS, 0),
            *(_OSMESA_PROFILE, _OSMESA_CORE_PROFILE),
            *(_OSMESA_CONTEXT_MAJOR_VERSION, 3, _OSMESA_CONTEXT_MINOR_VERSION, 3, 0),
        )
        attributes = (ctypes.c_int * len(wanted))(*wanted)
        self._context = self._library.OSMesaCreateContextAttribs(attributes, None)
        if not self._context:
            raise OSError(f"{name} cannot make an OpenGL 3.3 context")
        # OSMesa wants a color buffer although everything is drawn into framebuffer objects.
        self._buffer = (ctypes.c_ubyte * 4)()
        self.__enter__()

    def __enter__(self) -> OSMesa:
        """Make this context the current one of the calling thread."""
        if not self._library.OSMesaMakeCurrent(
            self._context, self._buffer, _GL_UNSIGNED_BYTE, 1, 1
        ):
            raise OSError("OSMesaMakeCurrent failed")
        return self

    def __exit__(self, *exception: object) -> None:
        """Leave the context current: entering another one replaces it."""

    def load_opengl_function(self, name: str) -> int:
        """Return the address of a GL function, 0 when unknown."""
        return self._library.OSMesaGetProcAddress(name.encode()) or 0

    def release(self) -> None:
        """Destroy the context."""
        if self._context:
            self._library.OSMesaDestroyContext(self._context)
            self._context = None


def _room_for_shaders() -> bool:
    """Return whether Mesa may keep what it compiles, a second of every preview.

    It maps that cache into memory: where a disk gets full that is a SIGBUS.
    """
    folder = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")).absolute()
    existing = next(path for path in (folder, *folder.parents) if path.exists())
    return shutil.disk_usage(existing).free > SHADER_ROOM


def create_context(backend: str | None = None) -> Any:
    """Return a ``moderngl.Context`` (OpenGL 3.3 core) that needs no display.

    Arguments:
        backend: ``osmesa``, ``egl``, or None: the one named by the environment variable
            ``TACTILUX_GL``, else the first that works.

    Raises:
        GraphicsError: when none works, with the line that mends it.
        RenderError: there is not enough memory.
    """
    require_memory(PREVIEW, "the preview")
    os.environ.setdefault("MESA_SHADER_CACHE_DISABLE", "false" if _room_for_shaders() else "true")
    # Untyped: moderngl's stubs know neither `context` nor `backend`.
    make: Any = importlib.import_module("moderngl").create_context
    wanted = backend or os.environ.get(VARIABLE)
    if wanted and wanted not in BACKENDS:
        raise GraphicsError(
            f"{VARIABLE} = {wanted!r} is not an OpenGL back end, allowed: {', '.join(BACKENDS)}",
            field=VARIABLE,
        )
    failures = []
    for name in [wanted] if wanted else BACKENDS:
        try:
            if name == "osmesa":
                return make(standalone=True, context=OSMesa())
            return make(standalone=True, backend="egl")
        # moderngl raises bare Exception, ImportError or ValueError, depending on what is missing.
        except Exception as error:
            failures.append(f"{name}: {error}")
    raise GraphicsError(
        f"no OpenGL library can draw the preview ({'; '.join(failures)}); install one with "
        "`sudo apt install libosmesa6` or, where that package is gone, "
        "`sudo apt install libegl1 libgl1 libgl1-mesa-dri`",
        field=VARIABLE,
    )
