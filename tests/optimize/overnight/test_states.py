"""A night of a skin with states: verified in all of them, and bit-equal after kills."""

from __future__ import annotations

import random
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from optimize.design import RUN_MODEL
from optimize.overnight.result import OvernightResult
from render.scene import load_scene
from surrogate.runtime import Checker
from tests.long import LONG
from tests.optimize.overnight.conftest import SAMPLES
from tests.optimize.overnight.tiny import outcome
from tests.optimize.overnight.warm import WarmProgram, WarmRun, wait_for
from tests.oracles.soft_domes import scene_text_of, write_files, written

pytestmark = pytest.mark.slow

KILLED_IN = ("Transport table", "Surrogate", "Round 1", "Final verification")


def write_soft_dome(folder: Path) -> Path:
    """Return the file of a dome of two sites, whose lamps turn, at rest and twisted."""
    write_files(folder, steps=16)
    text = scene_text_of("twisted")
    for old, new in (("turns = false", "turns = true"), ("columns = 3", "columns = 2"),
                     ("sites.rows = 3", "sites.rows = 1"), ("faces = 6", "faces = 4")):  # fmt: skip
        assert old in text
        text = text.replace(old, new)
    written(folder, text)
    return folder / "scene.toml"


@pytest.mark.skipif(not LONG, reason="part of make validation-long")
def test_a_night_of_states_ends_bit_equal_after_kills(
    warm_program: WarmProgram, tmp_path: Path
) -> None:
    scene, rng = write_soft_dome(tmp_path), random.Random(5)

    def attempt(run: str, report: bool) -> WarmRun:
        words = ("overnight", scene, "--out", tmp_path / run, "--samples", SAMPLES)
        return warm_program.start(*words, report=report)

    began = time.monotonic()
    code, said = attempt("unbroken", report=True).wait()
    assert code == 0, said
    seconds = time.monotonic() - began

    for stage in KILLED_IN:
        log = tmp_path / "broken" / "log.txt"
        known = len(log.read_text()) if log.is_file() else 0
        process = attempt("broken", report=False)
        wait_for(tmp_path / "broken", stage, process, known)
        time.sleep(rng.uniform(0.0, 0.03) * seconds)
        process.send(signal.SIGKILL)
        assert process.wait()[0] == -signal.SIGKILL
    code, said = attempt("broken", report=False).wait()
    assert code == 0, said
    assert outcome(tmp_path / "broken") == outcome(tmp_path / "unbroken")

    night = OvernightResult.load(tmp_path / "unbroken")
    # The night keeps the meshes of all states beside its scene.
    assert night.scene.hash == load_scene(tmp_path / "unbroken" / "scene.toml").hash
    assert night.scene.state_names == ("rest", "twisted")
    for entry in night.finalists:
        assert entry.metric.shape == (2, 2)
        over_sites, over_states = (entry.metric.mean(axis=axis).std() for axis in (0, 1))
        # S of eq. (4.7), with states where slabs have bends; the jackknife has moved it a little.
        assert entry.rating.spread_bends == pytest.approx(over_states, abs=entry.se)
        plain = entry.metric.mean() - over_sites - over_states
        assert entry.score == pytest.approx(plain, abs=2 * entry.se)
    checker = Checker.load(tmp_path / "unbroken" / RUN_MODEL, night.scene.hash)
    assert checker.metadata.states == ["rest", "twisted"]
    assert np.array_equal(checker.metadata.scene_bends, [0.0, 1.0])
    html = (tmp_path / "unbroken" / "report.html").read_text()
    assert ">rest<" in html
    assert ">twisted<" in html
