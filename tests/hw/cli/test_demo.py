"""The demonstration with calibration, from end to end; only the physics is a toy."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from render.scene import load_scene
from surrogate.preview_model import preview_checker
from tests.colored_skins import tinted_digit
from tests.conftest import Run
from tests.hw.calibration.toy import toy_images, toy_model, toy_table


@pytest.mark.slow
def test_the_demonstration_recovers_the_rigs_true_values(
    tactilux: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model = toy_model(toy_table(load_scene("finger20")))
    monkeypatch.setattr("hw.calibration.calibration.line_model", lambda *_: model)
    monkeypatch.setattr(
        "hw.emulator.demonstration.rendered_images",
        lambda setup, truth, *_, **__: toy_images(setup.scene, truth.material, 200, 120),
    )
    result = tactilux(
        "hw", "demo", "--calibrate", "--samples", "0", "--out", tmp_path / "demo", "--json"
    )
    assert result.code == 0, result.err
    assert "With calibration this takes about 40 minutes" in result.err
    said = json.loads(result.out)
    assert {name: check["ok"] for name, check in said["checks"].items()} == {
        "healthy": True,
        "fiber 4 dead": False,
        "fiber 9 at half power": False,
        "fiber 12 with swapped colors": False,
    }
    truth = {row["name"]: row for row in said["truth"]}
    for name in ("reduced_scattering", "absorption", "sigma_v"):
        assert truth[name]["inside"] or abs(truth[name]["error"]) < 0.1, truth[name]
    assert np.isfinite(said["seconds"])
    assert (tmp_path / "demo" / "report.html").stat().st_size > 50_000
    assert (tmp_path / "demo" / "scene.toml").exists()


def test_the_demonstration_without_calibration_runs_on_a_clear_pad_of_three_lamps(
    tactilux: Run, tmp_path: Path
) -> None:
    # Without a record one healthy rig in twenty is unclear (2 of 37 seeds), that of seed 0 is one.
    result = tactilux("hw", "demo", "--scene", "digit", "--seed", "1", "--json")
    assert result.code == 0, result.err
    said = json.loads(result.out)["checks"]
    found = {name: [fiber["state"] for fiber in check["fibers"]] for name, check in said.items()}
    assert found == {
        "healthy": ["ok", "ok", "ok"],
        "fiber 0 dead": ["dead", "ok", "ok"],
        "fiber 1 at half power": ["ok", "dim", "ok"],
        "fiber 2 with swapped colors": ["ok", "ok", "swapped"],
    }


@pytest.mark.slow
def test_the_demonstration_runs_on_a_skin_with_an_albedo_per_channel(
    tactilux: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for place in ("optimize.scoring", "hw.calibration.calibration"):
        monkeypatch.setattr(
            f"{place}.open_model", lambda scene, *_, **__: preview_checker(scene, coarse=True)
        )
    result = tactilux("hw", "demo", "--calibrate", "--scene", tinted_digit(tmp_path),
                      "--rig-samples", "300",
                      "--samples", "0", "--out", tmp_path / "demo", "--json")  # fmt: skip
    assert result.code == 0, result.err
    said = json.loads(result.out)
    found = {
        name: [fiber["state"] for fiber in check["fibers"]]
        for name, check in said["checks"].items()
    }
    assert found == {
        "healthy": ["ok", "ok", "ok"],
        "fiber 0 dead": ["dead", "ok", "ok"],
        "fiber 1 at half power": ["ok", "dim", "ok"],
        "fiber 2 with swapped colors": ["ok", "ok", "swapped"],
    }
    truth = {row["name"]: row for row in said["truth"]}
    assert list(truth)[:4] == ["albedo_red", "albedo_green", "albedo_blue", "roughness"]
    largest = max(list(truth.values())[4:], key=lambda row: row["found"])
    assert largest["found"] == largest["true"] == 1.0
    after = load_scene(tmp_path / "demo" / "scene.toml")
    assert after.by_channel
    assert after.palette.names == ("red", "green", "blue")


@pytest.mark.slow
def test_the_demonstration_calibrates_a_rigid_clear_pad_of_three_lamps(
    tactilux: Run, tmp_path: Path
) -> None:
    result = tactilux("hw", "demo", "--calibrate", "--scene", "digit",
                      "--rig-samples", "300", "--samples", "0",
                      "--out", tmp_path / "demo", "--json")  # fmt: skip
    assert result.code == 0, result.err
    said = json.loads(result.out)
    truth = {row["name"]: row for row in said["truth"]}
    assert list(truth)[:2] == ["albedo", "roughness"]
    for row in said["truth"][:2]:
        assert 0.0 <= said["material"][row["name"]]["interval"][0] <= row["found"]
    assert said["confirmation"] is None
    # The matrix of LED colors and channels, each value but the largest, which is 1.
    assert len(truth) == 2 + 9
    for color in ("red", "green", "blue"):
        for channel in ("red", "green", "blue"):
            row = truth[f"{color} in {channel}"]
            assert row["found"] == pytest.approx(row["true"], abs=0.01)
    after = load_scene(tmp_path / "demo" / "scene.toml")
    assert after.palette.names == ("red", "green", "blue")
    assert after.coating.albedo == pytest.approx(said["material"]["albedo"]["value"], rel=1e-5)


def test_calibration_of_a_curved_skin_raises_one_clear_error_before_anything_is_drawn(
    tactilux: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("optimize.scoring.open_model", lambda *_, **__: pytest.fail("drawn"))
    result = tactilux("hw", "demo", "--calibrate", "--scene", "digit-dome")
    assert result.code == 2
    assert "scene digit-dome has a curved skin" in result.err
    assert result.err.count("\n") == 1
