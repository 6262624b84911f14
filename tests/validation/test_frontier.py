"""The whole frontier of a small sensor, rendered for real with as little as it takes."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from optimize.cli import main
from render.chebyshev import chebyshev_nodes
from render.files import read_json
from render.preview import Preview
from render.scene import load_scene
from render.transport import TransportTable
from surrogate.train import TrainConfig, train
from surrogate.training.fit_task import FitConfig
from surrogate.training.mlp import NetworkConfig

SMALLER = {
    'name = "finger20"': 'name = "small3"',
    "left = 8": "left = 1",
    "tip = 4": "tip = 1",
    "right = 8": "right = 1",
    "columns = 3": "columns = 1",
    "rows = 5": "rows = 2",
    "faces = 10": "faces = 4",
    "value = [0.0, 45.0, 90.0]": "value = [0.0, 45.0]",
}
NAMES = [
    "preview", "surrogate (few paths)", "surrogate (converged)", "surrogate (few renders)",
    "surrogate (table)", "checker.onnx", "checker.onnx, batches of 64",
    "bidirectional, MIS, 1 samples", "bidirectional, MIS, 4 samples",
    "PSSMLT, 4 samples", "volpath, 4 samples a pixel", "volpath, 16 samples a pixel",
]  # fmt: skip
STATES_NONE = ("table", "batches", "volpath")
"""Rows that state no interval of a score, or the same as another row."""
QUICK = TrainConfig(
    phi_nodes=5,
    preview_nodes=(7, 3),
    coarse=True,
    fit=FitConfig(members=2, network=NetworkConfig(width=8, steps=50), designs=20),
)
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a small scene, its table and its model into one folder."""
    folder = tmp_path_factory.mktemp("sensor")
    text = (Path(__file__).parents[2] / "render" / "scenes" / "finger20.toml").read_text()
    for old, new in SMALLER.items():
        assert old in text
        text = text.replace(old, new)
    (folder / "small3.toml").write_text(text)
    scene = load_scene(folder / "small3.toml")
    phi, bends = chebyshev_nodes(5, 0.0, np.pi), np.radians([0.0, 45.0])
    with Preview(scene) as preview:
        facets, pad = preview.transport(phi, bends)
    table = TransportTable(
        T=facets, se=0.01 * facets, phi=phi, exposure=1.0, lam=0.0, scene_hash=scene.hash,
        bends=bends, background=pad, background_se=0.01 * pad,
    )  # fmt: skip
    train(scene, folder / "models" / "small3", table=table, config=QUICK)
    return folder


@pytest.fixture
def frontier(
    sensor: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Run:
    monkeypatch.chdir(sensor)
    monkeypatch.setattr("surrogate.train.TrainConfig", lambda: QUICK)

    def run(*words: str) -> tuple[int, str, str]:
        arguments = ["tactilux", "frontier", *words]
        monkeypatch.setattr(sys, "argv", arguments)
        capfd.readouterr()
        try:
            main()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        said = capfd.readouterr()
        return code, said.out, said.err

    return run


REQUEST = ("--designs", "3", "--samples", "32")


def test_a_frontier_has_every_level_and_a_second_call_goes_on_from_the_first(
    frontier: Run, sensor: Path
) -> None:
    code, out, err = frontier("small3.toml", *REQUEST, "--json")
    assert code == 0, err
    result = json.loads(out)
    assert [row["name"] for row in result["rows"]] == NAMES
    assert result["left_out"] == {}
    for row in result["rows"]:
        assert row["seconds_per_design"] > 0
        assert row["facet_median_true"] <= row["facet_median"] <= row["facet_p95"]
        assert -1 <= row["kendall_tau"] <= 1
        assert row["score_median"] >= 0
        silent = any(word in row["name"] for word in STATES_NONE)
        assert (row["interval"] is None) == silent
        if not silent:
            assert 0 <= row["interval"]["score"] <= 1
    assert result["nominal"] == 0.9
    assert result["reference"]["samples"] == 32
    assert result["reference"]["score_se_median"] > 0
    kept = sensor / "runs" / "small3-frontier"
    assert (kept / "frontier.png").read_bytes()[:4] == b"\x89PNG"
    assert read_json(kept / "frontier.json") == result

    code, out, err = frontier("small3.toml", *REQUEST)
    assert code == 0, err
    assert "tau" in out
    assert "Reference: bidirectional, MIS, 32 samples per cell" in out
    again = json.loads((kept / "frontier.json").read_text())
    assert again["reference"]["scores"] == result["reference"]["scores"]
    for before, after in zip(result["rows"], again["rows"], strict=True):
        assert after["facet_median"] == pytest.approx(before["facet_median"], rel=1e-4)
        assert after["setup_seconds"] == before["setup_seconds"]


def test_several_scenes_make_one_table_and_a_scene_that_is_finished_is_taken_as_it_is(
    frontier: Run, sensor: Path
) -> None:
    both = sensor / "both"
    both.mkdir()
    text = (sensor / "small3.toml").read_text()
    (both / "small3.toml").write_text(text)
    (both / "other.toml").write_text(text.replace('"small3"', '"other"'))
    request = ("both", *REQUEST, "--out", "survey")
    code, out, err = frontier(*request, "--json")
    assert code == 0, err
    result = json.loads(out)
    assert {scene["scene"] for scene in result["scenes"]} == {"small3", "other"}
    assert [rung["rung"] for rung in result["rungs"]] == [
        "preview", "surrogate (few paths)", "surrogate (converged)", "surrogate (few renders)",
        "surrogate (table)", "checker.onnx", "1/32 of the reference", "1/8 of the reference",
    ]  # fmt: skip
    assert all(rung["scenes"] == 2 for rung in result["rungs"])
    assert (sensor / "survey" / "frontier.png").read_bytes()[:4] == b"\x89PNG"
    # As after a kill in the second scene: the first is not measured again.
    (sensor / "survey" / "small3" / "frontier.json").unlink()
    code, out, err = frontier(*request)
    assert code == 0, err
    assert "Over scenes" in out
    assert "small3, 2 of 2" in err
    assert "other, 1 of 2" not in err


def test_bad_input_is_one_sentence(frontier: Run, sensor: Path) -> None:
    foreign = sensor / "foreign"
    foreign.mkdir()
    (foreign / "notes.txt").write_text("mine")
    (sensor / "again.toml").write_text((sensor / "small3.toml").read_text())
    for words, text in (
        (("small3.toml", "--out", "foreign"), "holds files but no earlier result"),
        (("small3.toml", "--model", "nowhere"), "there is no checker.onnx in nowhere"),
        (("small3.toml", "again.toml"), "is a second scene of the name small3"),
        (("foreign",), "foreign holds no scene"),
        (("small3.toml", "digit", "--minutes", "5"), "allowed: 6 or more, 3 for each"),
        (("digit", "finger20", "--model", "nowhere"), "is of one scene"),
    ):
        code, out, err = frontier(*words)
        assert (code, out) == (2, "")
        assert text in err
