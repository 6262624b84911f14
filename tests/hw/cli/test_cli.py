"""The whole program's help is quick and complete."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
HEAVY = {"numpy", "pydantic", "torch", "mitsuba", "cma", "numba", "matplotlib", "onnxruntime"}
HEAVY |= {"scipy", "rich", "moderngl", "cv2", "serial", "yaml"}


def test_nothing_heavy_is_imported_before_a_command_runs() -> None:
    # All commands with their options: the program's help and a command's own need no more.
    code = "import sys, hw.cli; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert not HEAVY & set(done.stdout.split())


def test_help_names_the_commands_of_the_rig() -> None:
    for arguments, names in (
        (["--help"], ("explore", "check", "hw")),
        (["hw", "--help"], ("ports", "set", "sweep", "off", "capture", "calibrate", "demo")),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "hw.cli", *arguments],
            cwd=ROOT, capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert all(f"  {name} " in done.stdout for name in names)


def test_optimize_knows_nothing_of_the_rig() -> None:
    for package in ("render", "surrogate", "optimize"):
        for path in (ROOT / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            assert "import hw" not in text
            assert "from hw" not in text
