"""``tactilux explore`` goes from a scene to a better design, end to end, on a real small model."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from optimize.design import keep_scene, load_design, load_design_file
from optimize.scoring import TableScorer, search_table
from optimize.ui.output import fresh_directory, write_manifest
from render.levels import EFFORTS
from render.preview.converged import Effort, cache
from render.scene import StandaloneScene, load_scene
from render.scene import scene_text as shipped_text
from surrogate.runtime import Checker
from tests.oracles.random_scenes import random_content, scene_text

ROOT = Path(__file__).parents[3]
Run = Callable[..., Any]


@dataclass(frozen=True)
class Explored:
    """One run of the program in its own process: where, stdout, stderr and the result."""

    place: Path
    said: str
    log: str
    result: dict[str, Any]


@pytest.fixture(scope="module")
def explored(
    small_scene: Path, small_model: Path, tmp_path_factory: pytest.TempPathFactory
) -> Explored:
    place = tmp_path_factory.mktemp("explore")
    done = subprocess.run(
        [sys.executable, "-m", "optimize.cli", "explore", small_scene]
        + ["--model", small_model, "--json"],
        cwd=place,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return Explored(place, done.stdout, done.stderr, json.loads(done.stdout))


def test_it_beats_the_baseline_and_says_so_in_one_json_object(explored: Explored) -> None:
    result = explored.result
    assert list(result) == [
        "scene",
        "scene_hash",
        "baseline",
        "optimized",
        "design",
        "report",
        "objective",
        "readings",
        "proven_best_of",
        "ranking",
        "seconds",
        "warnings",
    ]
    for name in ("baseline", "optimized"):
        figures = result[name]
        low, high = figures["interval"]
        assert low <= figures["score"] <= high
        assert figures["level"] == "surrogate"
        assert figures["effort"] in EFFORTS
        assert 0.3 < figures["normal_error_deg"] < 20.0
        assert 0.3 < figures["reader_error_deg"] < 20.0
        spreads = figures["spread_sites"] + figures["spread_bends"]
        assert figures["score"] == pytest.approx(figures["mean"] - spreads, rel=1e-4)
    assert result["objective"] == "sensor"
    found, base = result["optimized"], result["baseline"]
    assert found["reader_error_deg"] < base["reader_error_deg"]
    gain = result["readings"]["regressor_mean"]
    assert gain["interval"][1] < 0.0
    assert gain["design"] == pytest.approx(found["reader_error_deg"])
    assert gain["baseline"] == pytest.approx(base["reader_error_deg"])


def test_a_search_for_the_score_finds_more_of_it(
    tactilux: Run, explored: Explored, small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    command = ("explore", small_scene, "--model", small_model, "--out", tmp_path / "s", "--json")
    done = tactilux(*command, "--objective", "score")
    result = json.loads(done.out)
    assert result["objective"] == "score"
    assert result["optimized"]["score"] > result["baseline"]["score"]
    assert result["optimized"]["score"] >= explored.result["optimized"]["score"]
    found, other = result["optimized"], explored.result["optimized"]
    assert found["reader_error_deg"] >= other["reader_error_deg"] - 0.02
    refused = tactilux(*command, "--objective", "place", "--shadow", 1.0)
    assert refused.code == 2
    assert "allowed: score" in refused.err


def test_the_design_that_it_writes_has_the_score_that_it_claims(
    explored: Explored, small_scene: Path, small_model: Path
) -> None:
    path = explored.place / explored.result["design"]
    scene, claimed = load_scene(small_scene), explored.result["optimized"]["score"]
    design = load_design(path, scene)
    again = Checker.load(small_model, scene.hash).run(
        design.phi[None], design.power[None], np.array(scene.bending.angles)
    )
    assert claimed == pytest.approx(float(again["score"][0]), abs=1e-3)
    rating = load_design_file(path).rating
    assert rating is not None
    assert rating.score == pytest.approx(claimed)


def test_pictures_designs_and_report_lie_in_the_result_directory(explored: Explored) -> None:
    assert {item.name for item in (explored.place / "runs").iterdir()} == {"small8-explore"}
    names = {item.name for item in (explored.place / "runs" / "small8-explore").iterdir()}
    kinds = {"scheme": "svg", "metric": "png", "degrees": "png", "facets": "png"}
    pictures = {f"{name}-{stage}.{kind}" for name, kind in kinds.items()
                for stage in ("baseline", "score", "optimized")}  # fmt: skip
    pictures |= {f"preview-{end}-{b}.png" for end in ("baseline", "optimized") for b in (0, 1)}
    texts = {"design.json", "baseline.json", "report.html", "result.json", "scene.toml"}
    texts |= {"mounted.json", "wiring.csv", "jig.stl", "play.html", "board.dxf", "board.svg"}
    assert names == pictures | texts | {"convergence.png"}


@pytest.mark.slow
def test_again_with_the_same_seed_it_finds_the_same_design_and_prints_a_table(
    tactilux: Run, explored: Explored, small_scene: Path, small_model: Path
) -> None:
    target = explored.place / "runs" / "small8-explore"
    before = (target / "design.json").read_bytes()
    again = tactilux("explore", small_scene, "--model", small_model, "--out", target)
    assert again.code == 0
    assert (target / "design.json").read_bytes() == before
    for word in ("Baseline", "Best S", "Optimized", "surrogate", "report.html"):
        assert word in again.out


def test_the_wiring_of_a_design_can_be_made_for_another_board_and_step(
    tactilux: Run, explored: Explored, small_scene: Path, small_model: Path
) -> None:
    design = explored.place / explored.result["design"]
    words = ["wiring", design, "--scene", small_scene, "--model", small_model]
    words += ["--step", 15, "--leds", "7,6,5,4,3,2,1,0", "--order", "grb", "--out", "sheet"]
    done = tactilux(*words, "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)
    assert result["problems"] == []
    assert result["score"] == pytest.approx(explored.result["optimized"]["score"], rel=0.1)
    sheet = Path("sheet")
    assert {item.name for item in sheet.iterdir()} == {
        "board.dxf", "board.svg", "jig.stl", "mounted.json", "result.json", "wiring.csv",
        "wiring.html",
    }  # fmt: skip
    mounted = load_design_file(sheet / "mounted.json")
    assert {angle % 15 for angle in np.round(mounted.angles_deg, 6)} == {0.0}
    assert mounted.rating is not None
    assert mounted.rating.score == pytest.approx(result["score"], abs=1e-3)
    rows = (sheet / "wiring.csv").read_text().splitlines()
    assert len(rows) == 1 + 8
    assert "0.06 mm of the diffuser" in (sheet / "wiring.html").read_text()
    again = tactilux(*words)
    assert again.code == 0
    assert "Angles are rounded to 15°" in again.out
    assert tactilux("wiring", design, "--leds", "1,2", "--scene", small_scene).code == 2


def test_the_searched_table_scores_as_the_model_does(small_model: Path) -> None:
    checker = Checker.load(small_model)
    fibers = checker.metadata.fibers
    scorer = TableScorer(search_table(checker))
    rng = np.random.default_rng(5)
    phi = rng.uniform(0.0, np.pi, (20, fibers))
    power = np.eye(3)[rng.integers(0, 3, (20, fibers))]
    direct = checker.run(phi, power, np.array(checker.metadata.scene_bends))["score"]
    table = [scorer.score(p, q) for p, q in zip(phi, power, strict=True)]
    assert np.abs(table - direct).max() < 0.2


@pytest.mark.slow
def test_the_first_answer_says_how_noisy_its_light_is(
    tactilux: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for effort in ("FEW_PATHS", "EFFORT"):
        few = Effort(photons=500, paths=128, arrivals=100_000, rounds=1)
        monkeypatch.setattr(cache, effort, few)
    scene = tmp_path / "random-13.toml"
    scene.write_text(scene_text(random_content(13)))
    said = tactilux("explore", scene, "--out", "found")
    assert said.code == 0, said.err
    line = next(line for line in said.err.splitlines() if "First answer" in line)
    assert re.search(r"baseline \d+\. The traced light paths leave noise of [0-9.]+%", line)
    assert line.endswith("Now for a more exact one")


@pytest.mark.slow
def test_it_refines_for_tolerances_and_shadows_within_constraints(
    tactilux: Run, small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    scene = tmp_path / "built.toml"
    scene.write_text(
        small_scene.read_text()
        + """
[constraints]
max_red = 2
power_green = { value = 0.5, source = "driver" }
[[constraints.fixed]]
fiber = 4
color = "blue"
angle = { value = 70.0, unit = "deg", source = "mounted" }
[tolerances]
led_power = { distribution = "normal", deviation = 0.1, unit = "relative", source = "x" }
fiber_angle = { distribution = "uniform", deviation = 4.0, unit = "deg", source = "x" }
"""
    )
    words = ["explore", scene, "--model", small_model, "--robust", "spread", "--shadow", 1.0]
    done = tactilux(*words, "--out", "run", "--json")
    assert done.code == 0, done.err
    study = json.loads(done.out)["study"]
    assert set(study["robust"]) == {"baseline", "colors", "optimized", "refined"}
    assert study["shadow_penalty"]["refined"] <= study["shadow_penalty"]["optimized"]
    assert {entry["name"] for entry in study["sensitivities"]} == {"led_power", "fiber_angle"}
    design = json.loads((tmp_path / "run" / "design.json").read_text())
    assert design["colors"].count("red") <= 2
    assert design["colors"][4] == "blue"
    assert design["angles_deg"][4] == pytest.approx(70.0)
    assert max(power[1] for power in design["power"]) <= 0.5
    assert "sensors as built" in (tmp_path / "run" / "report.html").read_text()


def test_a_design_for_tolerances_reads_better_on_built_sensors_than_the_baseline(
    tactilux: Run, small_scene: Path, small_model: Path, tmp_path: Path
) -> None:
    words = ["explore", small_scene, "--model", small_model, "--robust", "quantile"]
    done = tactilux(*words, "--out", "run", "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)
    built = result["study"]["robust"]
    assert set(built) == {"baseline", "score", "optimized", "refined"}
    assert {rating["objective"] for rating in built.values()} == {"sensor"}
    assert built["refined"]["tenth"] <= built["optimized"]["tenth"] + 0.02
    assert built["refined"]["tenth"] <= built["baseline"]["tenth"]
    # The closed form and the drawn reader are two ways to the same degrees.
    drawn = result["optimized"]["reader_error_deg"]
    assert built["refined"]["nominal"] == pytest.approx(drawn, rel=0.15)
    assert "sensor reader" in (tmp_path / "run" / "report.html").read_text()


def test_the_log_has_the_scores_of_the_result(explored: Explored) -> None:
    logged = re.findall(r" s  (\S.*?)\s+score\s+(\S+)", explored.log)
    assert logged[0] == ("start", f"{explored.result['baseline']['score']:.3f}")
    assert logged[-1][1] == f"{explored.result['optimized']['score']:.3f}"


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Return the angles that ``explore`` answers, ``first`` and ``last``, instead of a search."""
    angles = {"first": 1.0, "last": 2.0}

    def level(which: str) -> Callable[..., Any]:
        return lambda *_, **__: SimpleNamespace(level_name=which, file=None, photon_noise=None)

    def write(
        found: Any, kept: StandaloneScene, target: Path, elapsed: object, *, keep_other: bool
    ) -> dict[str, object]:
        with fresh_directory(target, keep="design.json" if keep_other else "") as folder:
            design = {"scene_hash": "ab", "angles_deg": [angles[found.level_name]], "power": [1]}
            (folder / "design.json").write_text(json.dumps(design))
            keep_scene(folder, kept)
            write_manifest(folder, {})
        return {}

    monkeypatch.setattr("optimize.scoring.is_prompt", lambda *_: False)
    monkeypatch.setattr("optimize.scoring.first_model", level("first"))
    monkeypatch.setattr("optimize.scoring.open_model", level("last"))
    monkeypatch.setattr("optimize.exploration.explore", lambda scene, checker, **_: checker)
    monkeypatch.setattr("optimize.report.write_exploration", write)
    monkeypatch.setattr("optimize.cli.explore._first_answer", lambda *_: "First answer")
    return angles


def angles_in(place: Path) -> dict[str, float]:
    """Return the angle of the design in each folder."""
    found = place.glob("*/design.json")
    return {path.parent.name: json.loads(path.read_text())["angles_deg"][0] for path in found}


def test_a_first_answer_gives_way_to_the_last_and_an_earlier_design_is_kept(
    tactilux: Run, answers: dict[str, float], tmp_path: Path
) -> None:
    assert tactilux("explore", "finger20", "--out", "run", "--json").code == 0
    assert angles_in(tmp_path) == {"run": 2.0}
    answers |= {"first": 3.0, "last": 4.0}
    assert tactilux("explore", "finger20", "--out", "run", "--json").code == 0
    assert angles_in(tmp_path) == {"run": 4.0, "run-1": 2.0}


def test_an_earlier_design_that_is_the_first_answer_again_is_kept_with_its_renders(
    tactilux: Run, answers: dict[str, float], tmp_path: Path
) -> None:
    answers["last"] = answers["first"]
    assert tactilux("explore", "finger20", "--out", "run", "--json").code == 0
    verified = Path("design-renders") / "verified-0123456789ab.json"
    (tmp_path / "run" / verified.parent).mkdir()
    (tmp_path / "run" / verified).write_text("{}")
    answers["last"] = 2.0
    assert tactilux("explore", "finger20", "--out", "run", "--json").code == 0
    assert angles_in(tmp_path) == {"run": 2.0, "run-1": 1.0}
    assert (tmp_path / "run-1" / verified).is_file()
    assert not (tmp_path / "run" / verified.parent).exists()


def test_a_scene_from_a_pipe_is_kept_as_it_was_read(
    tactilux: Run, answers: dict[str, float], tmp_path: Path
) -> None:
    text = (ROOT / "render/scenes/finger20.toml").read_text()
    pipe, end = os.pipe()
    os.write(end, text.encode())
    os.close(end)
    assert tactilux("explore", f"/dev/fd/{pipe}", "--out", "run", "--json").code == 0
    os.close(pipe)
    assert (tmp_path / "run" / "scene.toml").read_text() == text
    assert answers["last"] == angles_in(tmp_path)["run"]


def test_places_are_refined_and_kept_with_the_design(tactilux: Run, tmp_path: Path) -> None:
    text = shipped_text("digit").replace("rows = 4\n", "rows = 2\n")
    pitch = '{ value = 5.0, unit = "mm", source = "test" }'
    rails = [f'[[search.places]]\nedge = "{edge}"\npitch = {pitch}\n' for edge in ("left", "right")]
    (tmp_path / "mine.toml").write_text("\n".join([text, *rails]))
    done = tactilux("explore", "mine.toml", "--coarse", "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)
    said = re.search(r"Places refined by up to (\S+) mm: sensor reader (\S+)° to (\S+)°", done.err)
    assert said is not None
    assert float(said[3]) < float(said[2])
    assert result["optimized"]["reader_error_deg"] < float(said[2]) * 1.02
    kept = load_scene(tmp_path / "runs" / "digit-explore" / "scene.toml")
    along = {round(float(lamp.position[1]) % 2.5, 3) for lamp in kept.placed_lamps()[3:]}
    assert along - {0.0}  # not on the grid
    assert load_design(tmp_path / result["design"], kept).colors.size == kept.lamp_count
