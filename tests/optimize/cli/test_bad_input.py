"""Whatever a user gets wrong is one sentence on stderr and exit code 2, and nothing is written."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.design import Rating, ScoreSettings, baseline_design, save_design
from render.scene import load_scene, scene_text
from render.transport import TransportTable

Run = Callable[..., Any]
ROOT = Path(__file__).parents[3]


@pytest.fixture
def refused(tactilux: Run, tmp_path: Path) -> Callable[..., str]:
    """Run a command that must be refused, and return its sentence."""

    def run(*arguments: object) -> str:
        def content() -> dict[str, bytes]:
            files = [path for path in sorted(tmp_path.rglob("*")) if path.is_file()]
            return {str(path): path.read_bytes() for path in files}

        before = content()
        result = tactilux(*arguments)
        assert result.code == 2, result.err
        assert result.out == ""
        assert "Traceback" not in result.err
        lines = result.err.splitlines()
        sentences = [line for line in lines if line.startswith("tactilux: ")]
        assert lines[-1:] == sentences
        assert content() == before
        return str(sentences[0])

    return run


@pytest.fixture
def design(tmp_path: Path, small_scene: Path) -> Path:
    """Write the rated baseline design of the small sensor."""
    scene = load_scene(small_scene)
    rating = Rating("surrogate", 50.0, (45.0, 55.0), 70.0, 12.0, 8.0, ScoreSettings(1e5, 80.0))
    path = tmp_path / "design.json"
    save_design(path, baseline_design(scene), scene, rating)
    return path


def edit(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_an_unknown_scene_key(
    refused: Callable[..., str], small_scene: Path, tmp_path: Path
) -> None:
    scene = tmp_path / "typo.toml"
    scene.write_text(small_scene.read_text().replace("[coating]", "[coating]\nglossy = 1"))
    for command in ("explore", "describe", "render", "train"):
        assert "unknown key coating.glossy" in refused(command, scene)


def test_a_scene_that_is_not_there(refused: Callable[..., str]) -> None:
    assert "finger20" in refused("explore", "finger21")


@pytest.mark.parametrize(("angle", "allowed"), [(180.5, "at most 180"), (-1.0, "at least 0")])
def test_a_direction_outside_zero_to_pi(
    refused: Callable[..., str], design: Path, small_scene: Path, angle: float, allowed: str
) -> None:
    edit(design, lambda content: content["angles_deg"].__setitem__(3, angle))
    for command in (["verify", design, "--scene", small_scene],
                    ["render", small_scene, "--design", design]):  # fmt: skip
        sentence = refused(*command)
        assert f"angles_deg[3] = {angle}" in sentence
        assert allowed in sentence


def test_a_design_for_another_scene(
    refused: Callable[..., str], design: Path, small_scene: Path
) -> None:
    edit(design, lambda content: content.update(scene_hash="0" * 16))
    assert "another scene" in refused("verify", design, "--scene", small_scene)
    assert "another scene" in refused("render", small_scene, "--design", design)


def test_a_design_for_a_scene_that_is_not_shipped(
    refused: Callable[..., str], design: Path
) -> None:
    assert "--scene" in refused("verify", design)


def test_a_design_that_is_not_there_or_no_json(refused: Callable[..., str], tmp_path: Path) -> None:
    assert "cannot be read" in refused("verify", "nowhere.json")
    (tmp_path / "text.json").write_text("phi = 1")
    assert "not JSON" in refused("verify", "text.json")


def test_a_model_that_is_not_there(refused: Callable[..., str], small_scene: Path) -> None:
    assert "--model" in refused("explore", small_scene, "--model", "nowhere")
    assert "--model" in refused("optimize", small_scene, "--model", "nowhere")


def test_an_altered_model(
    refused: Callable[..., str], small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    copy = shutil.copytree(small_model, tmp_path / "model")
    with (copy / "checker.onnx").open("ab") as stream:
        stream.write(b"x")
    assert "altered" in refused("explore", small_scene, "--model", copy)


def test_a_corrupt_model_with_a_right_checksum(
    refused: Callable[..., str], small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    copy = shutil.copytree(small_model, tmp_path / "model")
    replace_model(copy, b"this is no protobuf")
    assert "it is no ONNX file" in refused("explore", small_scene, "--model", copy)


def test_a_foreign_model(
    refused: Callable[..., str], small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    from onnx import TensorProto, helper, load

    value = helper.make_tensor_value_info
    graph = helper.make_graph(
        [helper.make_node("Identity", ["x"], ["y"])],
        "foreign",
        [value("x", TensorProto.FLOAT, [1])],
        [value("y", TensorProto.FLOAT, [1])],
    )
    foreign = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)
    copy = shutil.copytree(small_model, tmp_path / "model")
    replace_model(copy, foreign.SerializeToString())
    assert "it says 'nothing'" in refused("explore", small_scene, "--model", copy)
    ours = load(small_model / "checker.onnx")
    helper.set_model_props(foreign, {one.key: one.value for one in ours.metadata_props})
    replace_model(copy, foreign.SerializeToString())
    assert "inputs ['x']" in refused("explore", small_scene, "--model", copy)


def test_a_model_of_another_scene(refused: Callable[..., str], small_model: Path) -> None:
    assert "another scene" in refused("explore", "finger20", "--model", small_model)


@pytest.mark.parametrize("command", ["explore", "render"])
def test_no_graphics_library(
    command: str, small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    model = ["--model", str(small_model)] if command == "explore" else []
    # A process of its own: the EGL library reads its list of drivers once.
    done = subprocess.run(
        [sys.executable, "-m", "optimize.cli", command, str(small_scene), *model],
        cwd=tmp_path,
        env=os.environ
        | {"TACTILUX_GL": "egl", "__EGL_VENDOR_LIBRARY_FILENAMES": "/nowhere.json"}
        | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "libosmesa6" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())


def test_no_compiler_library(
    refused: Callable[..., str],
    design: Path,
    small_scene: Path,
    small_model: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nowhere/libLLVM.so")
    verify = refused("verify", design, "--scene", small_scene, "--model", small_model)
    assert "libllvm19" in verify
    assert "libllvm19" in refused("train", small_scene)


def test_a_result_directory_with_other_files(
    refused: Callable[..., str], small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    sentence = refused("explore", small_scene, "--model", small_model, "--out", tmp_path)
    assert "left alone" in sentence


def test_a_place_that_takes_no_result_is_refused_before_the_work(
    refused: Callable[..., str],
    small_scene: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def worked(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr("render.preview.Preview.__init__", worked)
    (tmp_path / "folder").mkdir()
    assert "is a directory" in refused("render", small_scene, "--out", tmp_path / "folder")
    assert "is a directory" in refused("render", small_scene, "--out", "")
    assert "cannot be created" in refused("render", small_scene, "--out", "/dev/null/picture.png")
    assert "cannot be created" in refused("train", small_scene, "--out", "/dev/null/model")


def test_tables_that_colors_cannot_use(refused: Callable[..., str], tmp_path: Path) -> None:
    assert "does not exist" in refused("colors", "nowhere.npz")
    (tmp_path / "text.npz").write_text("no zip")
    assert "not a readable" in refused("colors", "text.npz")
    light = np.full((4, 2, 1, 2, 3), 1.0)
    TransportTable(light, 0 * light, np.array([0.0, 1.0]), 1.0, 1.0).save(tmp_path / "two.npz")
    assert "--phi-index" in refused("colors", "two.npz")
    assert "0 to 1" in refused("colors", "two.npz", "--phi-index", 2)


def test_constraints_that_contradict_each_other(
    refused: Callable[..., str], small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    tight = tmp_path / "tight.toml"
    few = "\n[constraints]\nmax_red = 1\nmax_green = 1\nmax_blue = 1\n"
    tight.write_text(small_scene.read_text() + few)
    assert "at least 8 together" in refused("explore", tight, "--model", small_model)


def test_weights_and_noise_that_are_no_numbers(
    refused: Callable[..., str], design: Path, small_scene: Path
) -> None:
    assert "finite weight" in refused("explore", small_scene, "--shadow", "inf")
    words = ["reconstruct", design, "--scene", small_scene]
    assert "finite number" in refused(*words, "--read-noise", "inf")


def test_the_thesis_knows_no_constraints(
    refused: Callable[..., str], small_scene: Path, tmp_path: Path
) -> None:
    limited = tmp_path / "limited.toml"
    limited.write_text(small_scene.read_text() + "\n[constraints]\nmax_red = 5\n")
    assert "--method loop" in refused("optimize", limited, "--method", "thesis")


def test_designs_that_cannot_be_reconstructed(
    refused: Callable[..., str], design: Path, small_scene: Path
) -> None:
    assert "--scene" in refused("reconstruct", design)


def test_an_option_that_does_not_exist_is_exit_code_two(tactilux: Run) -> None:
    result = tactilux("explore", "--fast")
    assert result.code == 2
    assert result.out == ""
    assert "--fast" in result.err


def replace_model(folder: Path, content: bytes) -> None:
    """Put other bytes into a model folder, with checksums that fit."""
    sums = (folder / "checker.sha256").read_text().splitlines()
    own = f"{hashlib.sha256(content).hexdigest()}  checker.onnx"
    lines = [own if line.endswith("checker.onnx") else line for line in sums]
    (folder / "checker.sha256").write_text("\n".join(lines) + "\n")
    (folder / "checker.onnx").write_bytes(content)


def test_a_page_to_play_with_of_nothing(
    refused: Callable[..., str], design: Path, small_scene: Path, tmp_path: Path
) -> None:
    assert "there is no scene 'finger21'" in refused("play", "finger21")
    assert "cannot be read" in refused("play", tmp_path / "none.json", "--scene", small_scene)
    assert "is a directory: name a file with --out" in refused("play", "--out", tmp_path)
    assert "allowed: .html, .htm" in refused("play", "--out", tmp_path / "page.png")
    edit(design, lambda content: content["angles_deg"].pop())
    assert "angles_deg has 7 entries, allowed: 8" in refused("play", design, "--scene", small_scene)


RUBBISH = {
    "nothing": b"",
    "another program's": bytes(range(256)),
    "Latin-1": "name = 'Straße'".encode("latin-1"),
    "a list in a list in a list": b"a = " + b"[" * 100_000,
    "a number without end": b"schema = " + b"9" * 5000,
    "a list": b"[1, 2]",
    "one table twice": b"[pad]\n[pad.width]\n[pad.width]\n",
    "no number": b"NaN",
    "a text of Windows": b"\xff\xfe\0\0",
}
FOREIGN = ("('", "Errno", "codec", "Error", "recursion", "sys.", "None", "allow_pickle", "ioctl")
"""What Python says of such files."""


@pytest.mark.parametrize("content", RUBBISH.values(), ids=RUBBISH)
@pytest.mark.parametrize("command", ["describe", "score", "verify", "colors", "check"])
def test_files_of_anything_are_told_in_our_words(
    refused: Callable[..., str], tmp_path: Path, command: str, content: bytes
) -> None:
    for name in ("rubbish.toml", "rubbish.json"):
        path = tmp_path / name
        path.write_bytes(content)
        words = ["finger20", "--camera", 0, "--lens"] if command == "check" else []
        sentence = refused(command, *words, path)
        assert str(path) in sentence
        assert not [word for word in FOREIGN if word in sentence], sentence
    assert "Is a directory" in refused(command, *words, tmp_path)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"angles_deg": 10**400}, "angles_deg = 10000"),
        ({"angles_deg": [True] * 20}, "angles_deg[0] = true, allowed: 0 to 180"),
        ({"power": 10**400}, "power has another form"),
        ({"power": ["1"] * 20}, "power has another form"),
        ({"power": [True] * 20}, "power has another form"),
        ({"colors": float("nan")}, "colors = NaN, allowed: r, g, b or -"),
        ({"colors": ["r"] * 19 + [None]}, "colors[19] = null, allowed: "),
        ({"scene": "a\0b"}, "is neither a shipped scene nor a file"),
    ],
)
def test_a_layout_of_other_things_than_numbers(
    refused: Callable[..., str], tmp_path: Path, given: dict[str, Any], sentence: str
) -> None:
    layout = {"scene": "finger20", "colors": "r" * 20, "angles_deg": 90.0} | given
    (tmp_path / "layout.json").write_text(json.dumps(layout))
    assert sentence in refused("score", "layout.json")


@pytest.mark.parametrize("name", ["latin.csv", "folder", "none.csv", r"a\u0000b.csv", "wide.csv"])
def test_a_file_of_lamps_that_is_none(
    refused: Callable[..., str], tmp_path: Path, name: str
) -> None:
    (tmp_path / "latin.csv").write_bytes("x,y\n1,ß".encode("latin-1"))
    (tmp_path / "wide.csv").write_text("a" * 200_000)
    (tmp_path / "folder").mkdir()
    text = scene_text("gelsight-mini").replace("schema = 2", f'schema = 2\nlamps_file = "{name}"')
    (tmp_path / "scene.toml").write_text(text)
    sentence = refused("describe", "scene.toml")
    assert "lamps_file = " in sentence
    assert not [word for word in FOREIGN if word in sentence], sentence


@pytest.mark.parametrize(
    ("out", "sentence"),
    [
        ("folder", "folder is a directory: name a file with --out"),
        ("text.txt", "text.txt does not end with a kind of file, allowed: .json"),
        ("text.txt/x.json", "text.txt/x.json cannot be created"),
    ],
)
def test_a_rated_design_has_a_place_before_it_is_rated(
    refused: Callable[..., str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    out: str,
    sentence: str,
) -> None:
    def worked(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr("optimize.scoring.open_model", worked)
    (tmp_path / "folder").mkdir()
    (tmp_path / "text.txt").write_text("precious")
    (tmp_path / "layout.json").write_text(
        json.dumps({"scene": "finger20", "colors": "r" * 20, "angles_deg": 90.0})
    )
    assert sentence in refused("score", "layout.json", "--out", out)


def test_places_and_names_that_are_none(refused: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "text.txt").write_text("precious")
    assert "text.txt is not a folder" in refused("train", "finger20", "--out", "text.txt")
    assert "name = nothing, allowed: small letters" in refused("new", "")
    (tmp_path / "none.stl").write_bytes(b"")
    assert "none.stl is no body that can be read" in refused("render", "--press", "none.stl")


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("render", "--bend", "181"), "'--bend': 181, allowed: at most 180"),
        (("render", "--bend", "nan"), "'--bend': nan, allowed: at most 180"),
        (("render", "--samples", "1.5"), "'--samples': 1.5, allowed: a whole number"),
        (("render", "--depth", "x"), "'--depth': x, allowed: a number"),
        (("train", "--minutes", "inf"), "'--minutes': inf, allowed: at most 600000"),
        (("overnight", "--hours", "1e300"), "'--hours': 1e300, allowed: at most 10000"),
        (("hw", "calibrate", "--flat", ".", "--noise", "-1"), "'--noise': -1, allowed: at least"),
    ],
)
def test_an_option_out_of_its_range_is_told_with_the_value(
    tactilux: Run, words: tuple[str, ...], sentence: str
) -> None:
    result = tactilux(*words)
    assert (result.code, result.out) == (2, "")
    assert sentence in result.err
    assert "Input should" not in tactilux("render", "--level", "x").err


def test_a_camera_that_sees_no_site_is_refused_and_drawn(tactilux: Run, tmp_path: Path) -> None:
    camera = scene_text("finger20").split("[camera]")[1].split("[", 1)[0]
    coarse = re.sub(r"(columns|rows) = \d+", r"\1 = 20", camera)
    (tmp_path / "scene.toml").write_text(scene_text("finger20").replace(camera, coarse))
    result = tactilux("describe", "scene.toml", "--out", "sensor.svg")
    assert result.code == 2
    assert "the camera sees none of 15 sites whole" in result.err
    assert "</svg>" in (tmp_path / "sensor.svg").read_text()


def test_a_kept_preview_outlives_a_shortage_of_handles_which_is_said(
    refused: Callable[..., str],
    tactilux: Run,
    design: Path,
    small_scene: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    words = ("score", design, "--scene", small_scene, "--coarse")
    assert tactilux(*words).code == 0
    (kept,) = (tmp_path / "cache").rglob("preview-*.npz")

    def fail(*_: object, **__: object) -> None:
        raise OSError(errno.EMFILE, "Too many open files")

    with monkeypatch.context() as short:
        short.setattr(np, "load", fail)
        assert refused(*words) == (
            f"tactilux: {kept} cannot be read, and is left as it is: Too many open files; close "
            "other programs and try again"
        )
    assert tactilux(*words).code == 0
