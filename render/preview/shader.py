"""Float shader passes: GLSL assembled from parts with #defines, textures in, float32 arrays out."""

from __future__ import annotations

from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.errors import GraphicsError

_COMPONENTS = {1: "r", 2: "rg", 3: "rgb", 4: "rgba"}


def source(*parts: str, defines: dict[str, str]) -> str:
    """Return one GLSL 3.30 text: version, defines, then the named files of ``render/shaders``."""
    folder = resources.files("render.preview") / "shaders"
    lines = ["#version 330 core"]
    lines += [f"#define {name} {value}" for name, value in sorted(defines.items())]
    return "\n".join(lines + [(folder / part).read_text(encoding="utf-8") for part in parts])


class ShaderPass:
    """One full-target draw: a fragment shader with its uniforms and input textures."""

    def __init__(self, context: Any, fragment: str) -> None:
        """Compile the program in ``context`` (a ``moderngl.Context``).

        Raises:
            GraphicsError: when the driver does not compile it.
        """
        self._context = context
        vertex = source("screen.vert", defines={})
        try:
            self._program = context.program(vertex_shader=vertex, fragment_shader=fragment)
        except Exception as error:  # moderngl.Error is a bare Exception.
            raise GraphicsError(
                f"the OpenGL driver does not compile the preview's shader: {error}"
            ) from error
        self._array = context.vertex_array(self._program, [])
        self._target: tuple[tuple[int, int, int], Any] | None = None

    def draw(
        self,
        size: tuple[int, int],
        components: int,
        uniforms: dict[str, Any],
        textures: dict[str, Any],
    ) -> NDArray[np.float32]:
        """Return what is drawn, ``(rows, columns, components)``, row 0 at the bottom.

        A uniform that the specialized shader does not use is left out.
        """
        target = self._target_of(size, components)
        for unit, (name, texture) in enumerate(textures.items()):
            if name in self._program:
                texture.use(unit)
                self._program[name].value = unit
        for name, value in uniforms.items():
            if name in self._program:
                self._program[name].value = value
        target.use()
        self._array.render(vertices=3)
        pixels = np.frombuffer(target.read(components=components, dtype="f4"), dtype=np.float32)
        return pixels.reshape(size[1], size[0], components)

    def _target_of(self, size: tuple[int, int], components: int) -> Any:
        """Return a target of this size; the last one is kept, as most draws are alike."""
        key = (*size, components)
        if self._target is None or self._target[0] != key:
            if self._target is not None:
                for part in (*self._target[1].color_attachments, self._target[1]):
                    part.release()
            color = self._context.texture(size, components, dtype="f4")
            self._target = key, self._context.framebuffer([color])
        return self._target[1]


def float_texture(context: Any, values: NDArray[Any], *, smooth: bool = False) -> Any:
    """Return a float32 texture of ``(rows, columns, components)``.

    Texels are fetched one by one, or interpolated (clamped at the border) when ``smooth``.
    """
    rows, columns, components = values.shape
    data = np.ascontiguousarray(values, dtype=np.float32)
    texture = context.texture((columns, rows), components, data.tobytes(), dtype="f4")
    texture.filter = (context.LINEAR, context.LINEAR) if smooth else (context.NEAREST,) * 2
    texture.repeat_x = texture.repeat_y = False
    return texture
