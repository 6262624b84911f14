"""The page to play with allows the colorings and directions that searches allow."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.design import limits_of
from optimize.placement import searched_scene
from optimize.play import page_data
from render.scene import Scene, load_scene

UPHILL = Path(page_data.__file__).with_name("page") / "uphill.js"
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="needs node")


def said_by_page(scene: Scene, values: np.ndarray, call: str) -> Any:
    """Return what a ``call`` of the page's limits says of each of ``values``."""
    page = {"limits": page_data._limits(limits_of(scene))}
    program = (
        f"const OFF = -1;\n{UPHILL.read_text()}\nconst limits = new Limits({json.dumps(page)});\n"
        f"console.log(JSON.stringify({json.dumps(values.tolist())}.map((c) => {call})));"
    )
    done = subprocess.run(["node", "-"], input=program, capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@needs_node
@pytest.mark.parametrize("runs", [1, 2, 3])
def test_few_lamps_and_few_runs_are_kept_to(runs: int) -> None:
    scene = searched_scene(load_scene("digit").with_(search={"runs": runs}), lamps=4)
    rng = np.random.default_rng(runs)
    colors = np.full((400, scene.lamp_count), -1)
    for row in colors:
        row[rng.choice(len(row), rng.integers(0, 6))] = rng.integers(0, 3)
        row[rng.choice(len(row), 2)] = rng.integers(0, 3, 2)
    allowed = limits_of(scene).fits(colors)
    assert 0.1 < allowed.mean() < 0.9
    assert said_by_page(scene, colors, "limits.allows(c)") == allowed.tolist()


@needs_node
@pytest.mark.parametrize(
    "search",
    [
        {"mirror": "x", "runs": 3},
        {"counts": [{"of": ["red"], "exactly": 7}, {"of": ["green", "blue"], "max": 15}]},
    ],
)
def test_mirrored_pairs_and_counts_are_kept_to(search: dict[str, object]) -> None:
    scene = load_scene("finger20").with_(
        schema=2, search=search | {"lamps": 19}, constraints={"off": True}
    )
    limits, rng = limits_of(scene), np.random.default_rng(0)
    allowed = np.stack(
        [limits.nearest_colors(rng.uniform(size=limits.allowed.shape)) for _ in range(30)]
    )
    moved = allowed.copy()
    moved[np.arange(30), rng.integers(0, 20, 30)] = rng.integers(-1, 3, 30)
    colors = np.concatenate([allowed, moved])
    fits = limits.fits(colors)
    assert fits[:30].all()
    assert not fits[30:].all()
    assert said_by_page(scene, colors, "limits.allows(c)") == fits.tolist()


@needs_node
def test_directions_settle_where_searches_have_them() -> None:
    scene = load_scene("finger20").with_(schema=2, search={"mirror": "x"})
    phi = np.random.default_rng(1).uniform(0.1, 3.0, (40, 20))
    found = said_by_page(scene, phi, "Array.from(limits.settle(Float64Array.from(c)))")
    assert np.array(found) == pytest.approx(limits_of(scene).nearest_directions(phi), abs=1e-9)
