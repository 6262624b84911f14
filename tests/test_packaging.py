"""What an installation brings: ranges that hold what is tested, and advice that works."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from optimize.cli import PACKAGES

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]
IMPORTED_AS = {
    "opencv-python-headless": "cv2", "pyserial": "serial", "pyyaml": "yaml",
    "scikit-learn": "sklearn",
}  # fmt: skip


def pinned() -> dict[str, str]:
    """Return the exact version of every package that CI installs."""
    lines = (ROOT / ".ci" / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pairs = [line.split("==") for line in lines if "==" in line]
    return {canonicalize_name(name): version.strip() for name, version in pairs}


def own(requirements: list[str]) -> list[Requirement]:
    """Return the requirements without those that name another extra of this project."""
    found = [Requirement(text) for text in requirements]
    return [item for item in found if item.name != PROJECT["name"]]


@pytest.mark.parametrize("extra", ["", *EXTRAS])
def test_ranges_hold_the_tested_version_and_end_before_the_next_major(extra: str) -> None:
    versions = pinned()
    for item in own(EXTRAS[extra] if extra else PROJECT["dependencies"]):
        assert item.specifier.contains(versions[canonicalize_name(item.name)]), item.name
        assert {part.operator for part in item.specifier} == {">=", "<"}, item.name


@pytest.mark.parametrize("extra", PACKAGES)
def test_the_program_knows_what_its_extras_install(extra: str) -> None:
    names = {item.name for item in own(EXTRAS[extra])}
    assert {IMPORTED_AS.get(name, name) for name in names} == set(PACKAGES[extra])


def test_nothing_advises_an_installation_from_an_index() -> None:
    folders = ("render", "surrogate", "optimize", "hw", "examples")
    sources = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    sources += [path for folder in folders for path in (ROOT / folder).rglob("*.md")]
    for path in (ROOT / "README.md", ROOT / "tactilux.py", *sources):
        text = path.read_text(encoding="utf-8")
        assert not re.search(r"install\b[^\n]*tactilux\[", text), path


def test_a_model_runs_on_numpy_and_onnxruntime_alone() -> None:
    program = (
        "import sys, numpy as np; from surrogate.runtime import Checker; "
        "assert 'onnxruntime' not in sys.modules; "
        "Checker.load('models/finger20').run(np.ones((1, 20)), np.ones((1, 20, 3)), np.zeros(1)); "
        "print(*{name.partition('.')[0] for name in sys.modules})"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert {"numpy", "onnxruntime"} <= loaded
    assert not loaded & {"pydantic", "typer", "rich", "PIL", *sum(PACKAGES.values(), ())}


@pytest.mark.slow
def test_an_installation_brings_its_models_and_finds_them_in_an_empty_folder(
    tmp_path: Path,
) -> None:
    sources, site, empty = tmp_path / "sources", tmp_path / "site", tmp_path / "empty"
    for name in ("render", "surrogate", "optimize", "hw", "models"):
        shutil.copytree(ROOT / name, sources / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE", "tactilux.py"):
        shutil.copy(ROOT / name, sources)
    subprocess.run(
        [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation",
         "--no-index", "--target", site, sources],
        check=True,
    )  # fmt: skip
    empty.mkdir()
    (empty / "mine.toml").write_text('scene = "finger20"\ncolors = "rrrrrrrrbbbbgggggggg"\n'
                                     "angles_deg = 90\n")  # fmt: skip
    program = "import hw, sys; assert 'site' in hw.__file__; from hw.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", program, "score", "mine.toml", "--json"],
        cwd=empty, env=os.environ | {"PYTHONPATH": str(site)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["difference"] == 0.0
