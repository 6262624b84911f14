"""Finding a usable LLVM for Dr.Jit and choosing Mitsuba's variant."""

from __future__ import annotations

import ctypes
import ctypes.util
import os
from pathlib import Path
from types import ModuleType

from render.errors import CompilerError
from render.memory import RENDERER, require_memory

VARIANT = "llvm_ad_mono"
# LLVM 15 and 16 stop with "Cannot select" on AVX-512 processors once a kernel is rich.
_CANDIDATES = ("libLLVM-19.so", "libLLVM.so.19.1", "libLLVM-19.so.1", "libLLVM.so.20.1",
               "libLLVM-18.so", "libLLVM.so.18.1", "libLLVM-17.so", "libLLVM-17.so.1")  # fmt: skip
_FOLDERS = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib")
_ADVICE = "install it with: apt-get install libllvm19, or set DRJIT_LIBLLVM_PATH to the library"


def ensure_llvm() -> str:
    """Point Dr.Jit at an LLVM library that works and return its path.

    A path that the user set in ``DRJIT_LIBLLVM_PATH`` is used as it is.

    Raises:
        CompilerError: when there is no library, or the one that the user named does not load.
        RenderError: there is not enough memory to compile and to render.
    """
    require_memory(RENDERER, "rendering")
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    if named:
        if not _loads(named):
            raise CompilerError(
                f"DRJIT_LIBLLVM_PATH = {named} is not a library that loads: {_ADVICE}",
                field="DRJIT_LIBLLVM_PATH",
            )
        return named
    for name in _CANDIDATES:
        for path in (name, *(str(Path(folder) / name) for folder in _FOLDERS)):
            if _loads(path):
                os.environ["DRJIT_LIBLLVM_PATH"] = path
                return path
    raise CompilerError(
        f"rendering needs LLVM 17 or later and none was found: {_ADVICE}",
        field="DRJIT_LIBLLVM_PATH",
    )


def mitsuba(variant: str = VARIANT) -> ModuleType:
    """Return Mitsuba with ``variant`` set and the plugins of this package registered."""
    try:
        import mitsuba as mi
    except ImportError:
        raise CompilerError(
            'rendering needs Mitsuba: in the folder of the sources run: pip install ".[train]"',
            field="mitsuba",
        ) from None
    if variant.startswith("llvm"):
        ensure_llvm()
    if mi.variant() != variant:
        mi.set_variant(variant)
    import render

    render.register_plugins()
    return mi


def _loads(path: str) -> bool:
    try:
        ctypes.CDLL(path)
    except OSError:
        return False
    return True
