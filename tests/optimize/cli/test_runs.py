"""``tactilux runs`` finds what every command has left behind, and names what is not whole."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import pytest

from optimize.design import load_design_file
from optimize.overnight.result import OvernightResult
from optimize.overnight.store import Store
from optimize.records import find_runs
from optimize.records.run_record import KINDS
from optimize.records.runs_page import color_letters
from render.scene import load_scene
from tests.optimize.browser import SCREENS, look, pale_text
from tests.optimize.overnight.tiny import request_of, tiny_scene

pytestmark = pytest.mark.slow

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ROOT = Path(__file__).parents[3]
Run = Callable[..., Any]
LITTLE = ("--samples", 2, "--final-samples", 2, "--final-seeds", 1, "--rounds", 1)


@pytest.fixture(scope="module")
def worked(
    small_scene: Path, small_model: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, Any]]:
    """Return a folder in which every command but ``overnight`` has worked, and what they said."""
    place = tmp_path_factory.mktemp("worked")
    shutil.copy(small_scene, place / "small8.toml")
    shutil.copytree(small_model, place / "models" / "small8")
    said = {}
    design = "runs/small8-explore/design.json"
    for words in (
        ("explore", "small8.toml", "--model", "models/small8"),
        ("verify", design, "--model", "models/small8", "--samples", 2, "--seeds", 2),
        ("optimize", "small8.toml", "--model", "models/small8", *LITTLE),
        ("play", design, "--model", "models/small8", "--out", "a page.html"),
        (
            "explore",
            "small8.toml",
            "--coarse",
            "--vary",
            "camera.distance=14.9,15.1",
            "--out",
            "runs/distances",
        ),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "optimize.cli", *map(str, words), "--json"],
            cwd=place, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        said["study" if "--vary" in words else words[0]] = json.loads(done.stdout)
    return place, said


@pytest.fixture
def folder(worked: tuple[Path, dict[str, Any]], run_directory: Path, tmp_path: Path) -> Path:
    """Return a copy with a finished night."""
    shutil.copytree(worked[0], tmp_path, dirs_exist_ok=True)
    run_directory.rename(tmp_path / "runs" / "night")
    return tmp_path


def listed(tactilux: Run, *words: object) -> dict[str, dict[str, Any]]:
    done = tactilux("runs", *words, "--json")
    assert done.code == 0, done.err
    return {row["path"]: row for row in json.loads(done.out)["runs"]}


def test_every_kind_of_run_is_listed_with_what_it_said_itself(
    tactilux: Run,
    folder: Path,
    worked: tuple[Path, dict[str, Any]],
    finished_night: OvernightResult,
) -> None:
    rows, said = listed(tactilux), worked[1]
    assert {row["kind"] for row in rows.values()} == set(KINDS)
    assert {row["state"] for row in rows.values()} == {"finished"}
    assert len(rows) == len(KINDS)

    explored, found = rows["runs/small8-explore"], said["explore"]["optimized"]
    assert (explored["score"], explored["interval"]) == (found["score"], found["interval"])
    assert (explored["scene"], explored["level"]) == ("small8", "surrogate")
    assert explored["effort"] == found["effort"]
    assert explored["reader_error_deg"] == found["reader_error_deg"]
    assert explored["normal_error_deg"] == found["normal_error_deg"]
    assert explored["scene_hash"] == said["explore"]["scene_hash"]
    assert explored["play"] == "runs/small8-explore/play.html"

    (verified,) = (row for row in rows.values() if row["kind"] == "verify")
    assert verified["score"] == said["verify"]["design"]["score"]
    assert verified["interval"] == said["verify"]["design"]["interval"]
    assert (verified["level"], verified["effort"]) == ("reference", None)
    for key in ("reader_error_deg", "normal_error_deg"):
        assert verified[key] == said["verify"]["design"][key]
    assert f"{said['verify']['difference']['value']:+.1f} over the baseline" in verified["note"]

    optimized, winner = rows["runs/small8-optimize"], said["optimize"]["finalists"]["winner"]
    assert optimized["score"] == winner["score"]["value"]
    assert optimized["level"] == "reference"

    night = rows["runs/night"]
    assert night["score"] == finished_night.best.score
    assert night["interval"] == list(finished_night.best.rating.interval)
    assert night["design"] == "runs/night/designs/winner.json"

    played = rows["a page.html"]
    assert played["score"] == pytest.approx(explored["score"], abs=0.05)
    low, high = explored["interval"]
    assert played["interval"][1] - played["interval"][0] == pytest.approx(high - low)
    assert "Kendall's tau" in rows["models/small8"]["note"]
    assert said["study"]["sentence"] in rows["runs/distances"]["note"]
    assert (rows["runs/distances"]["kind"], rows["runs/distances"]["scene"]) == ("study", "small8")


def test_the_page_shows_each_run_and_its_links_lead_to_files(
    tactilux: Run, folder: Path, chromium: Browser
) -> None:
    done = tactilux("runs", ".", "--out", "pages/list of runs.html")
    assert done.code == 0, done.err
    path = folder / "pages" / "list of runs.html"
    text = path.read_text()
    assert not re.search(r"<script|<link|@import|url\(|https?://", text)
    names = re.findall(r"<h3>(?:<a [^>]*>)?([^<]+)", text)
    assert set(names) == set(listed(tactilux)) - {str(path)}
    targets = re.findall(r'href="([^"]+)"', text)
    assert len(targets) >= 2 * 3 + 2  # reports and designs, a card, a page to play with
    for target in targets:
        assert (path.parent / unquote(target)).is_file(), target
    # Five designs of the small sensor, whose file lies here, and one night.
    pictures = re.findall(r'<img src="data:image/svg[^"]+" alt="([^"]+)"', text)
    assert len(pictures) == 6
    saved = load_design_file(folder / "runs" / "small8-explore" / "design.json").design
    letters = color_letters(saved, load_scene(folder / "small8.toml"))
    assert sum(letters in alt for alt in pictures) >= 3  # explored, verified, played
    for screen in SCREENS:
        seen = look(chromium, path, screen)
        assert (seen.page, seen.wide, seen.small, seen.blank) == (0, [], [], []), screen
        assert (seen.requests, seen.complaints) == ([], [])
    for scheme in ("light", "dark"):
        assert pale_text(chromium, path, scheme)[0] == []


def test_letters_tell_the_colors_edge_by_edge(small_scene: Path) -> None:
    from optimize.design import baseline_design

    scene = load_scene(small_scene)
    design = baseline_design(scene)
    assert color_letters(design, scene) == "left RRR, tip BB, right GGG"
    assert color_letters(design) == "RRRBBGGG"


@pytest.mark.parametrize(
    ("harm", "run", "state", "why"),
    [
        ("cut result.json", "runs/small8-explore", "damaged", "result.json is damaged"),
        ("rm result.json", "runs/small8-explore", "damaged", "result.json is missing"),
        ("rm report.html", "runs/small8-optimize", "damaged", "report.html missing"),
        ("cut design.json", "runs/small8-optimize", "damaged", "is not a valid design"),
        ("cut night.npz", "runs/night", "damaged", "no finished night"),
        ("cut checker.onnx", "models/small8", "damaged", "was altered"),
        ("rm checker.onnx", "models/small8", "damaged", "checker.onnx is missing"),
        ("rm small8-optimize", "runs/small8-optimize-renders", "unfinished", "No result in"),
        ("hide small8-explore", f"runs/.small8-explore.{'0' * 32}", "unfinished", "Whole, but"),
        ("cut a page.html", "a page.html", "damaged", "is cut off"),
        ("nan verified", "verified", "damaged", "is damaged (it is not as"),
    ],
)
def test_what_is_not_whole_is_named_with_its_reason(
    tactilux: Run, folder: Path, harm: str, run: str, state: str, why: str
) -> None:
    whole = listed(tactilux)
    deed, _, name = harm.partition(" ")
    places = [p for p in (folder / "runs", folder / "models", folder) if p.is_dir()]
    if name == "verified":
        (target,) = folder.rglob("verified-*.json")
        run = str(target.relative_to(folder))
        content = json.loads(target.read_text())
        content["design"]["score"] = float("nan")
        target.write_text(json.dumps(content))
    else:
        target = next(p for p in [folder / run / name, *(p / name for p in places)] if p.exists())
    if deed == "cut":
        size = target.stat().st_size if target.suffix != ".html" else 60_000
        target.write_bytes(target.read_bytes()[: size // 2])
    elif deed == "rm":
        shutil.rmtree(target) if target.is_dir() else target.unlink()
    elif deed == "hide":
        target.rename(folder / run)
    rows = listed(tactilux)
    assert (rows[run]["state"], rows[run]["score"]) == (state, None)
    assert why in rows[run]["note"]
    others = {path for path in whole if not path.startswith("runs/small8-explore")} - {run, name}
    assert others - {"runs/small8-optimize"} <= set(rows)
    said = tactilux("runs", "--out", "page.html")
    assert said.code == 0, said.err
    assert f"{run}, {state}: " in said.out
    assert f"{run}<" in (folder / "page.html").read_text()


def test_a_night_that_was_killed_says_so_and_goes_on(tactilux: Run, tmp_path: Path) -> None:
    scene, run = tiny_scene(tmp_path), tmp_path / "night"
    run.mkdir()
    shutil.copy(tmp_path / "tiny.toml", run / "scene.toml")
    store = Store(run, request_of(scene), print)
    row = listed(tactilux)["night"]  # nobody holds its lock, and its attempt has no end
    store.close("stopped")
    assert (row["kind"], row["state"], row["scene"]) == ("overnight", "lost", "tiny")
    assert row["score"] is None


def test_results_of_other_programs_are_none_of_ours(tactilux: Run, tmp_path: Path) -> None:
    (tmp_path / "result.json").write_text('{"accuracy": 0.9}')
    (tmp_path / "report.html").write_text("<h1>Theirs</h1>")
    (tmp_path / "node_modules").mkdir()
    (tmp_path / "node_modules" / "checker.onnx").write_text("x")
    assert find_runs(tmp_path) == []
    said = tactilux("runs")
    assert said.out == "There is no run in . yet: tactilux explore makes one\n"
    assert "no run here yet" not in said.out


def test_a_place_that_is_no_folder_or_takes_no_page_raises_one_clear_error(
    tactilux: Run, tmp_path: Path
) -> None:
    for words, sentence in (
        (("nowhere",), "nowhere is no folder: name the one in which your runs are"),
        (("--out", "page.png"), "allowed: .html, .htm"),
    ):
        done = tactilux("runs", *words)
        assert (done.code, done.out) == (2, "")
        assert sentence in done.err
        assert "Traceback" not in done.err
    assert not list(tmp_path.iterdir())


def test_a_folder_that_may_not_be_read_is_named_in_one_line(
    tactilux: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "closed").mkdir()
    opened = os.scandir

    def refusing(place: Any) -> Any:
        if os.fspath(place).endswith("closed"):
            raise PermissionError(errno.EACCES, "Permission denied", os.fspath(place))
        return opened(place)

    monkeypatch.setattr("os.scandir", refusing)
    said = tactilux("runs")
    assert said.code == 0
    assert said.err.count("cannot be read") == 1
    assert "closed cannot be read (Permission denied): runs in it are not listed" in said.err
