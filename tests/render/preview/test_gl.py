"""OpenGL contexts without a display."""

import ctypes.util

import numpy as np
import pytest

from render.errors import GraphicsError
from render.preview import gl

FRAGMENT = """#version 330 core
out vec4 color;
void main() {
    color = vec4(sin(0.1 * gl_FragCoord.xy), exp(-gl_FragCoord.x), 1e-20 * gl_FragCoord.y);
}
"""
VERTEX = """#version 330 core
void main() {
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
"""


def drawn(backend: str | None) -> np.ndarray:
    context = gl.create_context(backend)
    with context:
        program = context.program(vertex_shader=VERTEX, fragment_shader=FRAGMENT)
        target = context.framebuffer([context.texture((40, 30), 4, dtype="f4")])
        target.use()
        context.vertex_array(program, []).render(vertices=3)
        pixels = np.frombuffer(target.read(components=4, dtype="f4"), dtype=np.float32)
    context.release()
    return pixels.reshape(30, 40, 4)


def test_osmesa_and_egl_draw_the_same_floats() -> None:
    first, second = drawn("osmesa"), drawn("egl")
    np.testing.assert_allclose(first, second, rtol=1e-5)
    column = np.arange(40) + 0.5
    np.testing.assert_allclose(first[3, :, 0], np.sin(0.1 * column), rtol=1e-4)
    np.testing.assert_allclose(first[3, :, 2], np.exp(-column), rtol=1e-4)


def test_two_contexts_alternate() -> None:
    first, second = gl.create_context("osmesa"), gl.create_context("osmesa")
    for context, value in ((first, 1.0), (second, 2.0), (first, 3.0)):
        with context:
            target = context.framebuffer([context.texture((1, 1), 1, dtype="f4")])
            target.clear(value)
            assert np.frombuffer(target.read(components=1, dtype="f4"), "f4")[0] == value
    first.release()
    second.release()


def test_the_environment_chooses_the_back_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(gl.VARIABLE, "vulkan")
    with pytest.raises(GraphicsError, match=r"TACTILUX_GL = 'vulkan' .* allowed: osmesa, egl"):
        gl.create_context()


def test_an_argument_beats_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(gl.VARIABLE, "vulkan")
    gl.create_context("osmesa").release()


def test_a_missing_library_is_named_with_the_line_that_installs_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ctypes.util, "find_library", lambda name: f"lib{name}-not-there.so")
    with pytest.raises(GraphicsError, match="sudo apt install libosmesa6") as caught:
        gl.create_context()
    assert "osmesa: " in str(caught.value)
    assert "egl: " in str(caught.value)
