"""Where addresses are few the program says so, and neither loops nor aborts."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LIMITED = """
import resource, sys
import render.{room} as room
resource.setrlimit(resource.RLIMIT_AS, (900_000_000, 900_000_000))
from render.errors import RenderError
try:
    room.{call}()
except RenderError as error:
    print(error)
"""


@pytest.mark.parametrize(
    ("room", "call", "what"),
    [
        ("preview.gl", "create_context", "the preview"),
        ("reference.llvm", "ensure_llvm", "rendering"),
    ],
)
def test_a_limit_that_libraries_would_break_on_is_one_sentence(
    room: str, call: str, what: str
) -> None:
    code = LIMITED.format(room=room, call=call)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith(f"there is not enough memory for {what}, which takes")
    assert done.stdout.count("\n") == 1


@pytest.mark.parametrize(("room", "disabled"), [(1 << 62, "true"), (0, "false")])
def test_mesa_keeps_shaders_in_files_only_where_no_full_disk_would_cut_them(
    room: int, disabled: str, tmp_path: Path
) -> None:
    code = (
        f"import os; import render.preview.gl as gl; gl.SHADER_ROOM = {room}; "
        "gl.create_context().release(); print(os.environ['MESA_SHADER_CACHE_DISABLE'])"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "not there yet")}
    environment.pop("MESA_SHADER_CACHE_DISABLE", None)
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"{disabled}\n"
