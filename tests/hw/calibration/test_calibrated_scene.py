"""The calibrated scene file says where every value comes from, and is a valid scene."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hw.calibration.calibration import calibrated_toml
from hw.calibration.material_table import MaterialTable
from hw.calibration.rig_fit import fit_rig
from optimize.scoring import trained_model
from render.scene import Scene, load_scene, scene_text, sources
from render.transport import TransportTable
from surrogate.train import TrainConfig, train
from surrogate.training.fit_task import FitConfig
from surrogate.training.mlp import NetworkConfig
from tests.colored_scenes import SAID, scene_with
from tests.hw.calibration.toy import photographs, toy_model
from tests.optimize.cli.conftest import (  # noqa: F401
    small_model,
    small_reference,
    small_scene,
)


def test_fitted_values_say_calibrated_with_date_and_interval(
    scene: Scene, table: MaterialTable, tmp_path: Path
) -> None:
    found = fit_rig(scene, toy_model(table), photographs(scene)[0])
    path = tmp_path / "scene.toml"
    path.write_text(
        calibrated_toml(scene_text("finger20"), scene, found, "2026-01-31"), encoding="utf-8"
    )
    after = load_scene(path)
    assert after.name == "finger20-calibrated"
    assert after.diffuser is not None
    reduced = after.diffuser.sigma_s * (1 - after.diffuser.g)
    assert reduced == pytest.approx(found.material[0], rel=1e-5)
    assert after.fibers.sigma_v == pytest.approx(found.material[2], rel=1e-5)
    said = sources(path)
    for key in ("diffuser.sigma_s", "diffuser.sigma_a", "fibers.sigma_v", "pad.roughness"):
        assert said[key].startswith("calibrated 2026-01-31, 95 % interval")
    low, high = found.intervals[2]
    shown = said["fibers.sigma_v"].split("interval ")[1].split(" ")
    np.testing.assert_allclose([float(shown[0]), float(shown[2])], [low, high], rtol=1e-3)
    assert "cannot separate" in said["diffuser.g"]
    # Everything that was not fitted is as it was.
    assert after.camera == scene.camera
    assert after.sites == scene.sites
    assert said["pad.width"] == "assumed"


def test_lists_of_a_scene_come_back(scene: Scene, table: MaterialTable, tmp_path: Path) -> None:
    scene_with(tmp_path, SAID)
    found = fit_rig(scene, toy_model(table), photographs(scene)[0])
    path = tmp_path / "calibrated.toml"
    path.write_text(
        calibrated_toml((tmp_path / "scene.toml").read_text(), scene, found, "2026-01-31")
    )
    assert load_scene(path).palette == scene.palette


@pytest.mark.slow
def test_a_calibrated_scene_asks_for_a_model_of_its_own_and_then_finds_it(
    table: MaterialTable,
    scene: Scene,
    small_scene: Path,  # noqa: F811
    small_model: Path,  # noqa: F811
    small_reference: TransportTable,  # noqa: F811
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = fit_rig(scene, toy_model(table), photographs(scene)[0])
    path = tmp_path / "calibrated" / "scene.toml"
    path.parent.mkdir()
    path.write_text(
        calibrated_toml(small_scene.read_text(), load_scene(small_scene), found, "2026-01-31")
    )
    monkeypatch.chdir(tmp_path)
    shutil.copytree(small_model, tmp_path / "models" / "small8")
    after = load_scene(path)
    assert trained_model(after) is None
    # What `tactilux train calibrated/scene.toml` does, on a table that stands for renders.
    quick = FitConfig(members=2, network=NetworkConfig(width=8, steps=20), designs=40)
    train(
        after,
        Path("models") / after.name,
        table=replace(small_reference, scene_hash=after.hash),
        config=TrainConfig(preview_nodes=(9, 3), coarse=True, fit=quick),
    )
    for scene, name in ((after, "small8-calibrated"), (load_scene(small_scene), "small8")):
        found = trained_model(scene)
        assert found is not None
        assert found.file == Path("models") / name / "checker.onnx"
