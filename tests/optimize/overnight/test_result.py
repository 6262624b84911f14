"""A finished night is kept in plain files: whole, or refused with one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optimize.design import keep_scene, load_design_file
from optimize.overnight.result import MEASURED, Finalist, OvernightResult
from optimize.overnight.run_directory import RunError
from render.files import read_npz, write_npz
from render.scene import scene_text, standalone


def refusal(run: Path) -> str:
    with pytest.raises(RunError) as caught:
        OvernightResult.load(run)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def rewrite(path: Path, edit: Callable[[Any], object]) -> None:
    """Change the JSON in a night's file."""
    arrays = read_npz(path)
    content = json.loads(str(arrays["night"]))
    edit(content)
    write_npz(path, arrays | {"night": np.array(json.dumps(content))})


def test_a_night_survives_the_round_trip(
    run_directory: Path, finished_night: OvernightResult
) -> None:
    loaded = OvernightResult.load(run_directory)
    for name in ("scene", "replicates", "winner", "verdict", "steps", "trade", "facts"):
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
    keep_scene(other, standalone("finger20"))
    # Equal, though one of them took longer.
    replace(finished_night, facts=(("Time worked", "9 h"),)).save(other)
    files = [path for path in run_directory.rglob("*") if path.is_file()]
    assert len(files) == 3 + len(finished_night.finalists)
    assert (run_directory / MEASURED).read_bytes() != (other / MEASURED).read_bytes()
    for path in set(files) - {run_directory / MEASURED}:
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
    keep_scene(tmp_path, standalone("finger20"))
    assert "go on with tactilux overnight" in refusal(tmp_path)


@pytest.mark.parametrize("damage", ["bit", "half", "missing"])
def test_a_damaged_night_is_refused_and_says_who_makes_it_anew(
    run_directory: Path, damage: str
) -> None:
    path = run_directory / "night.npz"
    content = bytearray(path.read_bytes())
    if damage == "bit":
        content[len(content) // 2] ^= 1
    path.write_bytes(content[: len(content) // 2] if damage == "half" else content)
    if damage == "missing":
        path.unlink()
    assert "night.npz is no finished night" in refusal(run_directory)
    assert "writes it anew from the renders" in refusal(run_directory)


@pytest.mark.parametrize(
    ("edit", "word"),
    [
        (lambda night: night.update(schema=1), "another version"),
        (lambda night: night.update(winner="nobody"), "nobody"),
        (lambda night: night["finalists"][1].update(se=-1.0), "finalists[1].se = -1.0, allowed: "),
        (lambda night: night["finalists"][1].update(key="../x"), "../x"),
        (lambda night: night["finalists"].reverse(), "runner-up"),
        (lambda night: night.update(more=1), "more"),
        (lambda night: night.pop("verdict"), "verdict"),
        (lambda night: night.update(scene_hash="0" * 16), "another scene"),
    ],
)
def test_a_forged_night_is_refused(
    run_directory: Path, edit: Callable[[Any], object], word: str
) -> None:
    rewrite(run_directory / "night.npz", edit)
    assert word in refusal(run_directory)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("metric", np.full((5, 3, 15), np.nan)),
        ("counts", np.zeros((5, 3, 15, 9, 3))),
        ("metric_se", np.zeros((5, 3, 15), np.float32)),
    ],
)
def test_arrays_that_a_report_could_not_show_are_refused(
    run_directory: Path, name: str, array: np.ndarray
) -> None:
    path = run_directory / "night.npz"
    write_npz(path, read_npz(path) | {name: array})
    assert f"{name} is not finite float64 of shape (5, 3, 15" in refusal(run_directory)


def test_the_night_of_another_scene_is_refused(run_directory: Path) -> None:
    path = run_directory / "scene.toml"
    path.write_text(path.read_text().replace("value = 0.6, source", "value = 0.5, source"))
    assert "of another scene than scene.toml" in refusal(run_directory)
