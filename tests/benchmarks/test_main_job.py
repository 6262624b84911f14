"""The bounds of the main job, printed as shares of what is allowed; seconds are never asserted."""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from optimize.design import baseline_design
from render.geometry import ball, bolt
from render.preview import Preview
from render.scene import load_scene, shipped_scenes
from surrogate.runtime import Checker

MODELS = Path(__file__).parents[2] / "models"


def median_seconds(work: Callable[[], object], times: int) -> float:
    work()
    spent = []
    for _ in range(times):
        start = time.perf_counter()
        work()
        spent.append(time.perf_counter() - start)
    return statistics.median(spent)


def report(capsys: pytest.CaptureFixture[str], what: str, seconds: float, allowed: float) -> None:
    with capsys.disabled():
        print(f"\n{what}: {seconds:.3g} s, {seconds / allowed:.2f} of the allowed {allowed:g} s")


def tactilux(*words: str) -> str:
    command = [sys.executable, "-m", "optimize.cli", *words]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def test_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert "explore" in tactilux("--help")
    report(capsys, "tactilux --help", median_seconds(lambda: tactilux("--help"), 5), 0.3)


def test_exploring_finger20(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    start = time.perf_counter()
    printed = tactilux("explore", "finger20", "--out", str(tmp_path / "run"), "--json")
    report(capsys, "tactilux explore finger20", time.perf_counter() - start, 60.0)
    assert '"optimized"' in printed


def test_one_design_through_the_checker(capsys: pytest.CaptureFixture[str]) -> None:
    scene = load_scene("finger20")
    checker = Checker.load(MODELS / scene.name, scene.hash)
    # A thread that waits for one design costs more than it gives.
    single = Checker.load(MODELS / scene.name, scene.hash, threads=1)
    design = baseline_design(scene)
    phi = design.phi[None].astype(np.float32)
    power = design.power[None].astype(np.float32)
    bends = np.array(scene.bending.angles, dtype=np.float32)
    seconds = median_seconds(lambda: single.run(phi, power, bends), 200)
    report(capsys, "one design through checker.onnx", seconds, 1e-3)
    batch = 64
    many = np.repeat(phi, batch, axis=0), np.repeat(power, batch, axis=0)
    rate = 60.0 * batch / median_seconds(lambda: checker.run(*many, bends), 5)
    with capsys.disabled():
        print(f"\ndesigns per minute in batches of {batch}: {rate:.0f}, {rate / 1e4:.1f} of 10000")
    assert np.isfinite(checker.run(*many, bends)["score"]).all()


def test_a_preview_picture(capsys: pytest.CaptureFixture[str]) -> None:
    scene = load_scene("finger20")
    design = baseline_design(scene)
    with Preview(scene) as preview:

        def draw() -> np.ndarray:
            return preview.picture(design.phi, design.power, 0.5, 160, 120)

        report(capsys, "preview picture of 160 x 120", median_seconds(draw, 20), 50e-3)
        bends = np.array(scene.bending.angles)
        table = median_seconds(lambda: preview.transport(np.array([1.5]), bends), 20)
        report(capsys, "preview transport, one direction each", table, 20e-3)
        assert draw().max() > 0


@pytest.mark.parametrize("name", shipped_scenes())
def test_a_preview_picture_of_one_more_design(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, rng = load_scene(name), np.random.default_rng(0)
    lamps = scene.lamp_count
    for what, press in (("pyramids", None), ("bolt", bolt(scene)), ("ball", ball(scene))):
        with Preview(scene, imprint=press) as preview:

            def draw(preview: Preview = preview) -> np.ndarray:
                phi, colors = rng.uniform(0.6, 2.5, lamps), rng.integers(0, 3, lamps)
                return preview.picture(phi, np.eye(3)[colors], 0.0, 160, 120)

            assert draw().max() > 0  # what all designs share is made here
            report(capsys, f"{name}, {what}: one more design", median_seconds(draw, 10), 50e-3)
