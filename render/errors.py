"""The typed errors of tactilux: each names the field, the value and what is allowed."""

from __future__ import annotations


class TactiluxError(Exception):
    """Base of every error that a user can cause and can mend.

    The message is one sentence that holds value and range and ends with the next step; ``field``
    is what it is about. Commands print it on stderr and exit with code 2, and name the ``option``
    that is meant: the message itself has the words of Python.
    """

    def __init__(self, message: str, *, field: str = "", option: str = "") -> None:
        super().__init__(message)
        self.field, self.option = field, option


class SceneError(TactiluxError):
    """A scene file that cannot be used; lists every problem that was found in it."""


class DesignError(TactiluxError):
    """A design file that is malformed, out of range, or made for another scene."""


class TableError(TactiluxError):
    """A transport table with missing, non-finite or mismatched cells."""


class ReadError(TactiluxError):
    """A file that is whole for all that is known, but cannot be read just now; it stays."""


class ModelError(TactiluxError):
    """A surrogate model file that is corrupt, foreign, or made for another scene."""


class GraphicsError(TactiluxError):
    """No OpenGL library that can draw the preview without a display."""


class CompilerError(TactiluxError):
    """No LLVM library that the renderer can compile its kernels with."""


class RenderError(TactiluxError):
    """A render that cannot be made: unsupported content, or no light found."""
