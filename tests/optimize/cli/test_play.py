"""``tactilux play`` makes a page of any sensor, on the preview where nothing was trained for it."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.design import baseline_design
from optimize.records import find_runs
from optimize.scoring import TableScorer, open_model, search_table
from render.scene import load_scene

Run = Callable[..., Any]


def test_a_scene_without_a_model_has_a_page_on_the_preview_which_says_so(
    tactilux: Run, small_scene: Path, tmp_path: Path
) -> None:
    done = tactilux("play", small_scene, "--coarse", "--json")
    assert done.code == 0, done.err
    said = json.loads(done.out)
    assert said["page"] == "small8-play.html"
    text = (tmp_path / "small8-play.html").read_text()
    assert "There is no trained model of small8, so this page is made on the preview" in text
    assert f"tactilux play {small_scene} --coarse" in text
    assert "Drag a beam to turn it, click a lamp" in text
    (record,) = find_runs(tmp_path)
    assert (record.kind, record.level, record.scene) == ("play", "preview", "small8")
    scene = load_scene(small_scene)
    scorer, base = TableScorer(search_table(open_model(scene, coarse=True))), baseline_design(scene)
    assert record.score == pytest.approx(scorer.score(base.phi, base.power), abs=0.05)


def test_a_page_climbs_what_is_asked_for(tactilux: Run, small_scene: Path, tmp_path: Path) -> None:
    for asked, title in (("sensor", "Sensor reader"), ("place", "Place reader")):
        done = tactilux("play", small_scene, "--coarse", "--objective", asked)
        assert done.code == 0, done.err
        text = (tmp_path / "small8-play.html").read_text()
        assert f"--coarse --objective {asked}" in text
        assert f'<span class="label">{title}</span>' in text
        baseline, optimum = map(float, re.findall(r"(?:Baseline|Optimum) ([\d.]+)°", text))
        assert 0.0 < optimum < baseline
    assert tactilux("play", small_scene, "--objective", "depth").code == 2


def test_a_dome_has_a_page(tactilux: Run, tmp_path: Path) -> None:
    done = tactilux("play", "digit-dome", "--coarse")
    assert done.code == 0
    (page,) = tmp_path.glob("*.html")
    found = re.search(r'id="page">(.*?)</script>', page.read_text(), re.DOTALL)
    assert found is not None
    surface, dome = json.loads(found[1])["skins"][0]["surface"], load_scene("digit-dome")
    # Its crown is in the middle, and its corners lie lower by the sphere's sag.
    heights = np.array(surface["texels"]).reshape(surface["steps"], surface["steps"], 4)[..., 3]
    radius, reach = dome.skin.radius, np.hypot(dome.pad.width, dome.pad.length) / 2
    assert heights.max() == pytest.approx(dome.pad.thickness, abs=1e-4)
    sag = radius - np.sqrt(radius**2 - reach**2)
    assert heights[0, 0] == pytest.approx(dome.pad.thickness - sag, abs=1e-4)
