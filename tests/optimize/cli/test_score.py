"""``tactilux score`` rates layouts drawn by hand, and every command has the scene's one scale."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest

import optimize
from optimize.design import load_design_file, load_layout
from optimize.scoring import trained_model
from render.choose_exposure import scene_scale
from render.errors import DesignError, ModelError
from render.levels import EFFORTS
from render.scene import Scene, load_scene, unchecked
from render.transport import TransportTable
from surrogate.runtime import Checker

Run = Callable[..., Any]
BASELINE = "rrrbbggg"
"""The baseline's colors: left red, tip blue, right green."""


def layout(folder: Path, **keys: Any) -> Path:
    """Write a layout as JSON."""
    path = folder / "layout.json"
    path.write_text(json.dumps(keys))
    return path


def test_colors_and_angles_are_enough(
    tactilux: Run, small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'scene = "{small_scene}"\ncolors = "RGB RGB-R"\nangles_deg = 80\n')
    done = tactilux("score", path, "--model", small_model, "--out", "rated.json", "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)
    for name in ("baseline", "design"):
        part = result[name]
        assert part["level"] == "surrogate"
        assert part["effort"] in EFFORTS
        assert part["interval"][0] < part["score"] < part["interval"][1]
        assert part["score"] == pytest.approx(
            part["mean"] - part["spread_sites"] - part["spread_bends"], abs=1e-3
        )
    assert result["difference"] == result["design"]["score"] - result["baseline"]["score"]
    saved = load_design_file(tmp_path / "rated.json")
    assert saved.design.color_names[6] == "off"
    assert saved.rating is not None
    assert saved.rating.score == result["design"]["score"]

    again = tactilux("score", "rated.json", "--scene", small_scene, "--model", small_model)
    assert again.code == 0, again.err
    assert f"{saved.rating.score:.1f}" in again.out
    assert "against the baseline" in again.out


def test_the_baseline_drawn_by_hand_scores_as_the_baseline(
    tactilux: Run, small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    path = layout(tmp_path, colors=list(BASELINE), angles_deg=[90] * 8)
    words = ["score", path, "--scene", small_scene, "--model", small_model, "--json"]
    result = json.loads(tactilux(*words).out)
    assert result["difference"] == 0.0


def test_one_color_everywhere_is_not_called_better_without_a_but(
    tactilux: Run, small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    path = layout(tmp_path, colors="r" * 8, angles_deg=90)
    said = tactilux("score", path, "--scene", small_scene, "--model", small_model).out
    assert "but one color lights everything, which tells no azimuth" in " ".join(said.split())


def test_all_problems_of_a_layout_are_named_at_once(small_scene: Path, tmp_path: Path) -> None:
    path = layout(tmp_path, colors=["red", "pink"], angles_deg=[1, 200, "x"], note=1, power=[2])
    with pytest.raises(DesignError) as caught:
        load_layout(path, str(small_scene))
    for words in (
        "unknown key note",
        "colors has 2 entries, allowed: 8",
        'colors[1] = "pink", allowed: r, g, b or -',
        "angles_deg has 3 entries, allowed: 8",
        "angles_deg[1] = 200, allowed: 0 to 180",
        'angles_deg[2] = "x", allowed: 0 to 180',
        "power has another form than 8 numbers",
    ):
        assert words in str(caught.value)


def test_a_layout_needs_no_angles_where_no_lamp_turns(tmp_path: Path) -> None:
    _, design = load_layout(layout(tmp_path, colors="bgr"), "digit")
    np.testing.assert_array_equal(design.phi, np.pi / 2)
    with pytest.raises(DesignError, match="missing key angles_deg"):
        load_layout(layout(tmp_path, colors="r" * 20), "finger20")


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.json", "{", "it is not JSON"),
        ("a.json", "[1]", r"it is \[1\], allowed: keys colors and angles_deg"),
        ("a.toml", "colors = ", "it is not TOML"),
        ("a.toml", 'colors = "r"', "it names no scene"),
        ("a.toml", 'scene = "nowhere"', "is neither a shipped scene nor a file"),
        ("a.toml", 'scene = "finger20"', "missing key colors, .*; missing key angles_deg"),
    ],
)
def test_a_file_that_is_no_layout_raises_one_clear_error(
    tmp_path: Path, name: str, text: str, words: str
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(DesignError, match=words) as caught:
        load_layout(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_a_led_has_no_more_power_than_the_scene_allows(small_scene: Path, tmp_path: Path) -> None:
    scene = tmp_path / "dim.toml"
    scene.write_text(
        small_scene.read_text() + '[constraints]\npower_red = { value = 0.5, source = "driver" }\n'
    )
    path = layout(tmp_path, scene=scene.name, colors=BASELINE, angles_deg=90)
    assert load_layout(path)[1].power[0].tolist() == [0.5, 0.0, 0.0]


SHIPPED = Path(optimize.__file__).parents[1] / "models" / "finger20"


def test_a_model_is_found_by_the_scenes_hash_whatever_its_name_and_it_alone_is_opened(
    small_scene: Path, small_model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "of-my-rig").symlink_to(small_model)
    scene = unchecked(load_scene(small_scene), {"name": "renamed"})
    opened: list[bytes] = []
    session = onnxruntime.InferenceSession

    def counted(content: bytes, *words: Any, **more: Any) -> Any:
        opened.append(content)
        return session(content, *words, **more)

    monkeypatch.setattr(onnxruntime, "InferenceSession", counted)
    for known, folder in ((scene, Path("models/of-my-rig")), (load_scene("finger20"), SHIPPED)):
        found = trained_model(known)
        assert found is not None
        assert found.file == folder / "checker.onnx"
    assert len(opened) == 2
    other = unchecked(scene, {"coating": unchecked(scene.coating, {"albedo": 0.5})})
    assert trained_model(other) is None
    with pytest.raises(ModelError, match=r"there is no checker\.onnx in nowhere"):
        trained_model(other, Path("nowhere"))
    assert len(opened) == 2


@pytest.mark.slow
def test_the_scale_is_the_same_at_every_effort_and_a_noisy_model_is_not_offered_silently(
    tactilux: Run,
    small_scene: Path,
    small_model: Path,
    small_reference: TransportTable,
    tmp_path: Path,
) -> None:
    from surrogate.train import TrainConfig, train
    from surrogate.training.fit_task import FitConfig
    from surrogate.training.mlp import NetworkConfig

    scene: Scene = load_scene(small_scene)
    scale = scene_scale(scene)
    # A reference as noisy as a render of seconds.
    drawn = np.random.default_rng(1).standard_normal(small_reference.T.shape)
    noisy = replace(
        small_reference, T=small_reference.T * np.exp(drawn - 0.5), se=small_reference.T
    )
    quick = FitConfig(members=2, network=NetworkConfig(width=8, steps=20), designs=40)
    made = train(
        scene, tmp_path / "noisy", table=noisy, seed=7,
        config=TrainConfig(preview_nodes=(9, 3), coarse=True, fit=quick),
    )  # fmt: skip
    found = {
        "train, good renders": Checker.load(small_model),
        "train, bad renders": Checker.load(made.folder),
    }
    # The noisy model cannot rank designs, and does not pass for one that can.
    done = tactilux("explore", small_scene, "--model", made.folder, "--out", "explore")
    assert done.code == 0, done.err
    assert done.out.startswith("Note: This model has not shown that it can rank designs")
    told = json.loads((tmp_path / "explore" / "result.json").read_text())
    assert told["ranking"]["reliable"] is False
    assert told["warnings"][0].startswith("This model has not shown")
    saved = load_design_file(tmp_path / "explore" / "design.json").rating
    assert saved is not None
    scales = {name: (one.exposure, one.lam) for name, one in found.items()}
    scales["explore"] = (saved.settings.exposure, saved.settings.lam)
    for name, one in scales.items():
        assert one == pytest.approx((scale.exposure, scale.lam)), name


def test_fibers_that_would_meet_in_their_holder_are_named(
    tactilux: Run, small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    path = layout(
        tmp_path,
        scene=str(small_scene),
        colors=BASELINE,
        angles_deg=[170.0, 10.0, 90.0, 90.0, 90.0, 90.0, 90.0, 90.0],
    )
    done = tactilux("score", path, "--model", small_model, "--json")
    assert done.code == 0, done.err
    assert "fibers 0 and 1 at 170 and 10 deg meet" in " ".join(json.loads(done.out)["warnings"])


def test_a_design_of_a_run_is_answered_by_the_model_of_the_run(
    small_scene: Path, small_model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "run" / "designs").mkdir(parents=True)
    (tmp_path / "run" / "model").symlink_to(small_model)
    scene = load_scene(small_scene)
    for design in (Path("run/designs/winner.json"), Path("run/design.json")):
        found = trained_model(scene, design=design)
        assert found is not None
        assert found.file == Path("run/model/checker.onnx")
    assert trained_model(scene, design=Path("elsewhere/design.json")) is None
    # One of another scene is passed over.
    found = trained_model(load_scene("finger20"), design=Path("run/design.json"))
    assert found is not None
    assert found.file == SHIPPED / "checker.onnx"
