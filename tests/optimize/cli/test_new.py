"""`tactilux new` writes a scene file that loads, is described and explored; or nothing."""

from __future__ import annotations

import json
import os
import pty
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hw.calibration.material import material_space
from optimize.design import baseline_design, limits_of
from optimize.exploration import explore
from optimize.mounting import drilling_jig, stl_bytes
from optimize.placement import searched_scene
from optimize.scoring import open_model
from render.choose_exposure import scene_scale
from render.describe import describe, skin_tested, stale_sources
from render.errors import SceneError
from render.geometry import camera_coverage, counted_sites
from render.scene import load_scene, sources
from render.scene.new_scene import LAMPS, QUESTIONS, Answers, scene_file
from render.scene.scene_file import scene_from_text

Run = Callable[..., Any]


def test_without_answers_it_is_a_finger_whose_values_are_all_assumed(tactilux: Run) -> None:
    said = tactilux("new", "mine", "--json")
    assert said.code == 0
    assert json.loads(said.out)["file"] == "mine.toml"
    scene = load_scene("mine.toml")
    assert (scene.name, scene.lamp_count) == ("mine", 20)
    origins = sources("mine.toml")
    assert origins.keys() == sources("finger20").keys()
    assert all(origin.startswith("assumed") for origin in origins.values())
    described = tactilux("describe", "mine.toml")
    assert "15 of 15 sites count" in described.out


def test_flags_become_values_that_say_so(tactilux: Run) -> None:
    flags = ("--width", 20.5, "--length", 25, "--diffuser", 0, "--lamp", "led", "--tip", 0,
             "--base", 3, "--colors", "white,green,red", "--distance", 24)  # fmt: skip
    assert tactilux("new", "--out", "mini.toml", *flags).code == 0
    scene, origins = load_scene("mini.toml"), sources("mini.toml")
    assert scene.pad.width == 20.5
    assert scene.camera.distance == 24
    assert scene.diffuser is None
    assert [row.edge for row in scene.lamp_rows] == ["left", "right", "base"]
    assert set(scene.turning) == {False}
    assert scene.baseline_colors()[0] == "white"
    assert origins["pad.width"] == origins["camera.distance"] == "as given to tactilux new"
    assert origins["pad.thickness"] == "assumed"
    assert tactilux("describe", "mini.toml").code == 0


@pytest.mark.parametrize(
    ("size", "sites"),
    [((20, 25), 20), ((14, 32), 15), ((18, 30), 15), ((30, 18), 15), ((40, 40), 16)],
)
def test_sites_lie_on_most_of_the_skin_and_it_is_said_on_how_much(
    tactilux: Run, size: tuple[int, int], sites: int
) -> None:
    said = tactilux("new", "mine", "--width", size[0], "--length", size[1])
    scene = load_scene("mine.toml")
    assert len(counted_sites(scene)) == sites
    assert skin_tested(scene) > 0.4
    assert said.out.startswith(f"{sites} sites on {skin_tested(scene):.0%} of the skin; ")
    shown = f"sites that count lie on {skin_tested(scene):.0%} of the skin"
    assert shown in tactilux("describe", "mine.toml").out


def test_a_camera_that_sees_a_part_has_its_sites_there_and_that_is_said(tactilux: Run) -> None:
    said = tactilux("new", "mine", "--width", 20, "--length", 25, "--field-of-view", 40)
    scene = load_scene("mine.toml")
    assert camera_coverage(scene).seen.all()
    assert skin_tested(scene) < 0.2
    assert f"on {skin_tested(scene):.0%} of the skin" in said.out


@pytest.mark.parametrize(("lamp", "tilt"), [("fiber", 10), ("led", 0)])
def test_what_is_assumed_of_the_lamps_is_said(tactilux: Run, lamp: str, tilt: int) -> None:
    said = tactilux("new", "mine", "--lamp", lamp, "--thickness", 3)
    assert np.degrees(load_scene("mine.toml").placed_lamps()[0].tilt) == pytest.approx(tilt)
    assert f"lamps 1.5 mm above the lower face, tilted by {tilt}° towards the skin" in said.out


@pytest.mark.parametrize(
    ("old", "new", "sentences"),
    [
        ("thickness = { value = 4.0", "thickness = { value = 6.0",
         ["fibers.height = 2 mm comes from pad.thickness = 4 mm, which is 6 mm now"]),
        ("distance = { value = 10.0", "distance = { value = 14.0",
         ["camera.field_of_view = 99 deg comes from camera.distance = 10 mm, which is 14 mm now"]),
        ("width = { value = 18.0", "width = { value = 16.0",
         [f"{key} comes from pad.width = 18 mm, which is 16 mm now" for key in
          ("camera.distance = 10 mm", "sites.spacing = 5.3 mm", "indenter.radius = 0.6 mm")]),
        ("roughness = { value = 0.1", "roughness = { value = 0.2", []),
    ],
)  # fmt: skip
def test_a_value_made_from_another_is_told_of_when_that_changes(
    tactilux: Run, old: str, new: str, sentences: list[str]
) -> None:
    assert tactilux("new", "mine").code == 0
    path = Path("mine.toml")
    path.write_text(path.read_text().replace(old, new, 1))
    found = stale_sources(load_scene(path), sources(path))
    assert [told.split(":")[0] for told in found] == sentences
    said = tactilux("describe", path).out
    assert all(told in said for told in found)


def test_one_color_is_that_of_all_edges(tactilux: Run) -> None:
    assert tactilux("new", "--out", "white.toml", "--colors", "white", "--base", 2).code == 0
    scene = load_scene("white.toml")
    assert set(scene.baseline_colors()) == {"white"}
    assert scene.palette.names == ("white",)
    # Hue says nothing there, and the scale of scores does without it.
    assert scene_scale(scene).lam == 0


def test_a_gray_camera_has_leds_of_one_channel(tactilux: Run) -> None:
    words = ("--camera", "gray", "--tip", 0, "--diffuser", 0)
    assert tactilux("new", "mono", *words, "--colors", "white,infrared").code == 0
    scene = load_scene("mono.toml")
    assert scene.palette.channels == ("gray",)
    assert scene.palette.names == ("white", "infrared")
    assert set(scene.baseline_colors()) == {"white", "infrared"}
    assert scene_scale(scene).lam == 0
    assert tactilux("describe", "mono.toml").code == 0
    assert tactilux("new", "plain", *words).code == 0
    assert set(load_scene("plain.toml").baseline_colors()) == {"white"}


def test_amber_and_infrared_stand_beside_red_green_and_blue(tactilux: Run) -> None:
    assert tactilux("new", "warm", "--colors", "amber,infrared,blue").code == 0
    scene = load_scene("warm.toml")
    assert scene.palette.names == ("red", "green", "blue", "amber", "infrared")


@pytest.mark.parametrize("unlit", [("--left", 0, "--tip", 0), ("--tip", 0, "--right", 0)])
def test_lit_edges_differ_in_color_by_default(tactilux: Run, unlit: tuple[object, ...]) -> None:
    assert tactilux("new", "--out", "two.toml", "--base", 3, *unlit).code == 0
    scene = load_scene("two.toml")
    assert set(scene.baseline_colors()) == {"red", "blue"}
    assert scene_scale(scene).lam > 0


def test_new_fibers_are_those_that_jigs_and_calibration_know(tactilux: Run) -> None:
    assert tactilux("new", "ends", "--tip", 2, "--left", 3).code == 0
    scene = load_scene("ends.toml")
    assert scene.fibers is not None
    assert (scene.fibers.left, scene.fibers.tip, scene.fibers.right) == (3, 2, 8)
    assert stl_bytes(drilling_jig(scene, baseline_design(scene)))
    assert "sigma_v" in material_space(scene).names
    assert tactilux("new", "round", "--base", 2).code == 0
    scene = load_scene("round.toml")
    assert scene.fibers is None
    assert [row.size for row in scene.lamp_rows] == [8, 4, 8, 2]
    assert all(scene.turning)


def test_a_new_scene_is_explored_at_once(tactilux: Run) -> None:
    words = ("--lamp", "led", "--diffuser", 0, "--left", 2, "--tip", 1, "--right", 2)
    assert tactilux("new", "quick", *words, "--width", 8, "--length", 8).code == 0
    scene = load_scene("quick.toml")
    checker = open_model(scene, coarse=True)
    assert checker.level == "preview"
    found = explore(scene, checker)
    assert found.stages[-1].rating.score >= found.stages[0].rating.score


def test_no_file_is_overwritten(tactilux: Run) -> None:
    Path("mine.toml").write_text("precious")
    said = tactilux("new", "mine")
    assert (said.code, said.out) == (2, "")
    assert said.err == "tactilux: mine.toml is there: name another file with --out\n"
    assert Path("mine.toml").read_text() == "precious"


@pytest.mark.parametrize(
    ("flags", "sentence"),
    [
        (("--width", 101), "--width = 101, allowed: 4 to 100 mm"),
        (("--width", "nan"), "--width = nan, allowed: 4 to 100 mm"),
        (("--field-of-view", 175), "--field-of-view = 175, allowed: 5 to 170 deg"),
        (("--left", 65), "--left = 65, allowed: 0 to 64"),
        (("--left", 41), "--left = 41, allowed: 0 to 40 lamps of 0.75 mm side by side"),
        (("--left", 0, "--tip", 0, "--right", 0), "are 0, allowed: at least one lamp"),
        (("--colors", "red,pink,blue"), "--colors names pink, allowed: red, green, blue, white"),
        (("--colors", "red,blue"), "names 2 colors, allowed: 3, one for each edge with lamps"),
        (("--colors", ""), "--colors names , allowed: red"),
        (("--distance", 500, "--field-of-view", 170), "allowed: for example 10 mm with 99 deg"),
        (("--out", "mine.txt"), "mine.txt does not end with a kind of file, allowed: .toml"),
    ],
)
def test_a_bad_value_is_one_sentence_and_leaves_no_file(
    tactilux: Run, flags: tuple[object, ...], sentence: str
) -> None:
    said = tactilux("new", *flags)
    assert (said.code, said.out) == (2, "")
    assert said.err.startswith("tactilux: ")
    assert said.err.count("\n") == 1
    assert sentence in said.err
    assert not list(Path().iterdir())


def test_lamps_that_are_placed_have_rails_along_the_edges_with_lamps(tactilux: Run) -> None:
    flags = ("--place-lamps", 6, "--lamp", "led", "--tip", 0, "--diffuser", 0, "--left", 4)
    assert tactilux("new", "mine", *flags, "--length", 20).code == 0
    scene = load_scene("mine.toml")
    assert scene.search is not None
    assert scene.search.lamps == 6
    assert [rail.edge for rail in scene.search.places] == ["left", "right"]
    searched = searched_scene(scene)
    # Two rails of 1 mm LEDs at 2 mm, less what the lamps there take.
    assert scene.lamp_count < searched.lamp_count <= scene.lamp_count + 2 * 10
    assert limits_of(searched).most_lit == 6
    assert "at most 6 lamps lit" in tactilux("describe", "mine.toml").out


def test_the_largest_pad_has_no_more_places_than_are_searched() -> None:
    numbers = {"width": 100.0, "length": 100.0, "base": 9.0, "place_lamps": 4.0}
    scene = scene_from_text(scene_file(Answers("mine", numbers)), "mine", Path())
    assert 100 < searched_scene(scene).lamp_count < 256


@pytest.mark.parametrize(("name", "said"), [("finger20", "comes with tactilux"), ("My x", "small")])
def test_a_name_that_cannot_be_is_refused(tactilux: Run, name: str, said: str) -> None:
    refused = tactilux("new", name)
    assert refused.code == 2
    assert refused.err.startswith(f"tactilux: name = {name}")
    assert said in refused.err


def numbers_of_questions() -> st.SearchStrategy[dict[str, float]]:
    def strategy(name: str) -> st.SearchStrategy[float]:
        question = QUESTIONS[name]
        if not question.unit:
            return st.integers(0, 9).map(float)
        # A diffuser of some micrometers is a mistake that scenes do not allow.
        return st.floats(max(question.low, 0.05), question.high)

    return st.fixed_dictionaries({}, optional={name: strategy(name) for name in QUESTIONS})


@settings(max_examples=150, deadline=None)
@given(numbers=numbers_of_questions(), lamp=st.sampled_from(sorted(LAMPS)))
def test_whatever_is_answered_within_the_ranges_is_a_scene(
    numbers: dict[str, float], lamp: str
) -> None:
    try:
        answers = Answers("mine", numbers, lamp)
    except SceneError as error:
        refused = str(error)
        assert "side by side" in refused or "at least one lamp" in refused
        return
    scene = scene_from_text(scene_file(answers), "mine", Path())
    assert scene.lamp_count == sum(answers.size(edge) for edge in answers.lit)


@pytest.mark.parametrize("size", [(4, 4, 1), (4, 100, 1), (100, 100, 1), (100, 4, 50), (8, 8, 50)])
def test_a_camera_that_nobody_describes_sees_the_pad(size: tuple[float, float, float]) -> None:
    numbers = dict(zip(("width", "length", "thickness"), size, strict=True))
    scene = scene_from_text(scene_file(Answers("mine", numbers)), "mine", Path())
    assert describe(scene)
    assert camera_coverage(scene).seen.all()


def at_terminal(folder: Path, *typed: str, stop: int = 0) -> tuple[int, str]:
    """Answer at a pseudo terminal, or send the signal ``stop`` after the last answer.

    Return the exit code and everything that the terminal showed.
    """
    ours, theirs = pty.openpty()
    # Started in the background, tests would hand on that SIGINT is ignored.
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    code += "from hw.start import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "new", "typed"],
        stdin=theirs, stdout=theirs, stderr=theirs, cwd=folder, start_new_session=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )  # fmt: skip
    os.close(theirs)
    shown, answers, began = "", list(typed), time.monotonic()
    try:
        while time.monotonic() - began < 60:
            if not select.select([ours], [], [], 1.0)[0]:
                continue
            try:
                shown += os.read(ours, 4096).decode()
            except OSError:  # the process is gone
                break
            if shown.endswith("]: "):
                if answers:
                    os.write(ours, f"{answers.pop(0)}\n".encode())
                elif stop:
                    process.send_signal(stop)
                    stop = 0
        return process.wait(30), shown
    finally:
        process.kill()
        os.close(ours)


def test_a_terminal_is_asked_and_bad_answers_again(tmp_path: Path) -> None:
    typed = ("led", "sepia", "", "", "3", "25", "", "none", "0", "", "0", "2.5", "2", *[""] * 5)
    code, shown = at_terminal(tmp_path, *typed)
    assert code == 0, shown
    assert "sepia, allowed: color, gray" in shown
    assert "--length = 3, allowed: 4 to 100 mm" in shown
    assert "none, allowed: a number, 0 to 20 mm" in shown
    assert "2.5, allowed: a whole number, 0 to 64" in shown
    scene, origins = load_scene(tmp_path / "typed.toml"), sources(tmp_path / "typed.toml")
    assert (scene.pad.width, scene.pad.length) == (18, 25)
    assert (origins["pad.width"], origins["pad.length"]) == ("assumed", "as given to tactilux new")
    assert scene.diffuser is None
    assert [(row.edge, row.size) for row in scene.lamp_rows] == [("left", 8), ("right", 2)]


def test_ctrl_c_leaves_no_file(tmp_path: Path) -> None:
    code, shown = at_terminal(tmp_path, "fiber", "", "20", stop=signal.SIGINT)
    assert code == 130
    assert "tactilux: interrupted" in shown
    assert not list(tmp_path.iterdir())
