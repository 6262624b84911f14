"""A whole calibration, from photographs in folders to scene, report and JSON.

Only the physics is a toy (drawing materials takes minutes): the rest is what users run.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from hw.calibrated_powers import calibrated_powers
from hw.camera.photo_set import PhotoSet, save_photos
from render.files import read_json
from render.scene import load_scene, sources
from tests.conftest import Run
from tests.hw.calibration.toy import IMPERFECTIONS, PHOTOGRAPHED, taken, toy_model, toy_table


def save(photos: PhotoSet, folder: Path) -> Path:
    named = {f"fiber-{fiber:02d}": photo for fiber, photo in photos.alone.items()}
    if photos.together is not None:
        named["all"] = photos.together
    # Files hold no negative counts: a black level and the dark frame that has it.
    lifted = {name: np.maximum(photo + 8.0, 0.0) for name, photo in named.items()}
    save_photos(lifted | {"dark": np.full(photo_shape(named), 8.0)}, folder)
    return folder


def photo_shape(photos: dict[str, np.ndarray]) -> tuple[int, ...]:
    return next(iter(photos.values())).shape


@pytest.mark.slow
def test_photographs_become_a_calibrated_scene(
    tactilux: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene("finger20")
    model = toy_model(toy_table(scene))
    monkeypatch.setattr("hw.calibration.calibration.line_model", lambda *_: model)
    sets, additive, _ = taken(scene, IMPERFECTIONS)
    flat, bent, sums = (
        save(photos, tmp_path / name)
        for photos, name in ((sets[0], "flat"), (sets[1], "bent"), (additive, "additive"))
    )
    result = tactilux("hw", "calibrate", "--flat", flat, "--bent", bent, "--linearity", sums,
                      "--samples", "0", "--out", tmp_path / "out", "--json")  # fmt: skip
    assert result.code == 0, result.err
    said = json.loads(result.out)
    assert said["material"]["reduced_scattering"]["value"] == pytest.approx(1.3, rel=0.1)
    assert said["material"]["absorption"]["value"] == pytest.approx(0.03, rel=0.1)
    assert said["material"]["sigma_v"]["value"] == pytest.approx(
        math.degrees(PHOTOGRAPHED[2]), rel=0.1
    )
    assert said["confirmation"] is None
    assert "g and sigma_s" in said["caveats"][0]
    calibrated = tmp_path / "out" / "scene.toml"
    assert load_scene(calibrated).hash == said["scene_hash"]["after"]
    assert sources(calibrated)["diffuser.sigma_a"].startswith("calibrated ")
    assert "data:image/png" in (tmp_path / "out" / "report.html").read_text()
    assert read_json(tmp_path / "out" / "calibration.json") == said
    # Running it again replaces its own result, and prints a table for people.
    again = tactilux("hw", "calibrate", "--flat", flat, "--bent", bent, "--linearity", sums,
                     "--samples", "0", "--out", tmp_path / "out")  # fmt: skip
    assert again.code == 0
    assert "g and sigma_s cannot be separated" in again.out
    assert f"Next: `tactilux train {calibrated}`" in again.out
    # And the commands after it read what it wrote.
    found = calibrated_powers(tmp_path / "out" / "calibration.json", None, scene.hash, 20)
    assert found is not None
    assert found.power.mean() == pytest.approx(1.0)
    assert (found.error < 0.05).all()
