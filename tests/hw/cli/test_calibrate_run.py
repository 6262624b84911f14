"""A whole calibration, from photographs in folders to scene, report and JSON.

Only the physics is a toy (drawing materials takes minutes): the rest is what users run.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from hw.calibration.material_table import MaterialTable, _fitted, sobol_materials
from hw.camera.photo_set import PhotoSet
from hw.cli.capture import save_photos
from render.scene.schema import load_scene, sources
from tests.conftest import Run
from tests.hw.calibration.conftest import BENDS, toy_log_light
from tests.hw.calibration.test_rig_fit import IMPERFECTIONS, TRUE, model_of, taken


def toy_table() -> MaterialTable:
    scene = load_scene("finger20")
    materials = sobol_materials(32)
    drawn = np.stack([toy_log_light(scene, one) for one in materials])
    drawn = drawn + 0.003 * np.random.default_rng(0).standard_normal(drawn.shape)
    return _fitted("toy", np.full(20, np.pi / 2), BENDS, materials, drawn)


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


def test_photographs_become_a_calibrated_scene(
    tactilux: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = toy_table()
    monkeypatch.setattr("hw.calibration.rig_fit.line_model", lambda *_: model_of(table))
    sets, additive, _ = taken(load_scene("finger20"), IMPERFECTIONS)
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
        math.degrees(TRUE.sigma_v), rel=0.1
    )
    assert said["confirmation"] is None
    assert "g and sigma_s" in said["not_separable"]
    scene = tmp_path / "out" / "scene.toml"
    assert load_scene(scene).hash == said["scene_hash"]["after"]
    assert sources(scene)["diffuser.sigma_a"].startswith("calibrated ")
    assert "data:image/png" in (tmp_path / "out" / "report.html").read_text()
    assert json.loads((tmp_path / "out" / "calibration.json").read_text()) == said
    # Running it again replaces its own result, and prints a table for people.
    again = tactilux("hw", "calibrate", "--flat", flat, "--bent", bent, "--linearity", sums,
                     "--samples", "0", "--out", tmp_path / "out")  # fmt: skip
    assert again.code == 0
    assert "g and sigma_s cannot be separated" in again.out
