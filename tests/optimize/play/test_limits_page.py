"""The page to play with allows the colorings that searches allow."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from optimize.design import limits_of
from optimize.placement import searched_scene
from optimize.play import page_data
from render.scene import load_scene

UPHILL = Path(page_data.__file__).with_name("page") / "uphill.js"


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
@pytest.mark.parametrize("runs", [1, 2, 3])
def test_few_lamps_and_few_runs_are_kept_to(runs: int) -> None:
    scene = searched_scene(load_scene("digit").with_(search={"runs": runs}), lamps=4)
    limits = limits_of(scene)
    rng = np.random.default_rng(runs)
    colors = np.full((400, scene.lamp_count), -1)
    for row in colors:
        row[rng.choice(len(row), rng.integers(0, 6))] = rng.integers(0, 3)
        row[rng.choice(len(row), 2)] = rng.integers(0, 3, 2)
    allowed = limits.fits(colors)
    assert 0.1 < allowed.mean() < 0.9
    page = {"limits": page_data._limits(limits)}
    program = (
        f"const OFF = -1;\n{UPHILL.read_text()}\nconst limits = new Limits({json.dumps(page)});\n"
        f"console.log(JSON.stringify({json.dumps(colors.tolist())}.map((c) => limits.allows(c))));"
    )
    done = subprocess.run(["node", "-"], input=program, capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == allowed.tolist()
