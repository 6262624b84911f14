"""A finished night is kept in plain files: whole, or refused with one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.design import load_design_file
from optimize.overnight.result import Finalist, OvernightResult, ResultError, keep_scene
from render.scene import load_scene, scene_text


def refusal(run: Path) -> str:
    with pytest.raises(ResultError) as caught:
        OvernightResult.load(run)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def rewrite(path: Path, edit: Callable[[Any], object]) -> None:
    content = json.loads(path.read_text())
    edit(content)
    path.write_text(json.dumps(content))


def test_a_night_survives_the_round_trip(
    run_directory: Path, finished_night: OvernightResult
) -> None:
    loaded = OvernightResult.load(run_directory)
    for name in ("scene", "settings", "replicates", "winner", "verdict", "steps", "trade", "facts"):
        assert getattr(loaded, name) == getattr(finished_night, name)
    for was, found in zip(finished_night.finalists, loaded.finalists, strict=True):
        np.testing.assert_allclose(found.design.phi, was.design.phi, rtol=0, atol=1e-15)
        np.testing.assert_array_equal(found.design.power, was.design.power)
        for part in fields(Finalist):
            if part.name != "design":
                np.testing.assert_array_equal(getattr(found, part.name), getattr(was, part.name))


def test_equal_nights_make_equal_bytes(
    run_directory: Path, tmp_path: Path, finished_night: OvernightResult
) -> None:
    other = tmp_path / "other"
    keep_scene(other, "finger20")
    finished_night.save(other)
    files = [path for path in run_directory.rglob("*") if path.is_file()]
    assert len(files) == 3 + len(finished_night.finalists)
    for path in files:
        assert path.read_bytes() == (other / path.relative_to(run_directory)).read_bytes()


def test_the_scene_keeps_its_comments_and_sources(run_directory: Path) -> None:
    assert (run_directory / "scene.toml").read_text() == scene_text("finger20")


def test_every_finalist_has_a_design_file_with_its_rendered_rating(
    run_directory: Path, finished_night: OvernightResult
) -> None:
    for entry in finished_night.finalists:
        rating = load_design_file(run_directory / "designs" / f"{entry.key}.json").rating
        assert rating is not None
        assert rating.level == "reference"
        assert rating.score == entry.score
        # Student's t with 15 degrees of freedom.
        assert rating.interval[1] - entry.score == pytest.approx(2.131 * entry.se, rel=1e-3)


def test_a_directory_without_a_night_says_what_to_do(tmp_path: Path) -> None:
    assert "go on with tactilux overnight" in refusal(tmp_path)


@pytest.mark.parametrize("name", ["night.npz", "scene.toml", "designs/winner.json"])
def test_a_flipped_bit_is_told_with_its_file(run_directory: Path, name: str) -> None:
    path = run_directory / name
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    assert name in refusal(run_directory)
    assert "go on with tactilux overnight" in refusal(run_directory)


@pytest.mark.parametrize("name", ["night.npz", "scene.toml", "designs/thesis.json"])
def test_a_missing_file_is_told_with_its_name(run_directory: Path, name: str) -> None:
    (run_directory / name).unlink()
    assert f"{name} is missing" in refusal(run_directory)


def test_half_a_record_is_refused(run_directory: Path) -> None:
    path = run_directory / "night.json"
    path.write_bytes(path.read_bytes()[:-200])
    assert "not a valid record" in refusal(run_directory)


@pytest.mark.parametrize(
    ("edit", "word"),
    [
        (lambda night: night.update(schema=2), "schema"),
        (lambda night: night.update(winner="nobody"), "nobody"),
        (lambda night: night["finalists"][1].update(se=-1.0), "finalists.1.se"),
        (lambda night: night["files"].pop("night.npz"), "files"),
        (lambda night: night["finalists"][1].update(key="../x"), "finalists.1.key"),
        (lambda night: night.update(scene_hash="0" * 16), "made for the scene of hash 0000"),
    ],
)
def test_a_forged_record_is_refused(
    run_directory: Path, edit: Callable[[Any], object], word: str
) -> None:
    rewrite(run_directory / "night.json", edit)
    assert word in refusal(run_directory)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"metric": np.full((3, 15), np.nan)}, "metric of baseline"),
        ({"counts": np.zeros((3, 15, 9, 3))}, "counts of baseline"),
        ({"se": -1.0}, "finalists.0.se"),
    ],
)
def test_impossible_numbers_are_not_written(
    tmp_path: Path, finished_night: OvernightResult, change: dict[str, Any], word: str
) -> None:
    keep_scene(tmp_path, "finger20")
    first, *others = finished_night.finalists
    with pytest.raises(ResultError, match=word):
        replace(finished_night, finalists=(replace(first, **change), *others)).save(tmp_path)
    assert not (tmp_path / "night.json").exists()


def test_a_night_is_not_put_into_the_directory_of_another_scene(
    run_directory: Path, finished_night: OvernightResult
) -> None:
    path = run_directory / "scene.toml"
    path.write_text(path.read_text().replace("value = 0.6, source", "value = 0.5, source"))
    assert load_scene(path).hash != finished_night.scene.hash
    with pytest.raises(ResultError, match="another scene"):
        finished_night.save(run_directory)
