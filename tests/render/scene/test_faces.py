"""Faces of their own roughness: what is read, what is refused, and when a scene is another."""

from __future__ import annotations

from pathlib import Path

import pytest

from render.errors import SceneError
from render.scene import FACES, Scene, load_scene, scene_content, scene_of

TEXT = (Path(__file__).parents[3] / "render" / "scenes" / "finger20.toml").read_text()
PLAIN = load_scene("finger20")
ROUGHNESS = 'roughness = {{ value = {value}, source = "assumed" }}'


def scene_with(folder: Path, *entries: tuple[str, float], schema: int = 2) -> Scene:
    """Return finger20 with entries of faces: the list of names as TOML, and their roughness."""
    text = TEXT.replace("schema = 1", f"schema = {schema}", 1)
    for names, value in entries:
        text += f"\n[[faces]]\non = {names}\n{ROUGHNESS.format(value=value)}\n"
    path = folder / "scene.toml"
    path.write_text(text)
    return load_scene(path)


def refusal(folder: Path, *entries: tuple[str, float], schema: int = 2) -> str:
    with pytest.raises(SceneError) as caught:
        scene_with(folder, *entries, schema=schema)
    return str(caught.value)


def test_named_faces_have_their_roughness_and_the_others_that_of_the_pad(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, ('["left", "right"]', 0.3), ('["lower"]', 0.0))
    roughness = {face: scene.finish(face).roughness for face in FACES}
    assert roughness == {"left": 0.3, "tip": 0.1, "right": 0.3, "base": 0.1, "lower": 0.0}
    assert scene_of(scene_content(scene)) == scene


def test_the_hash_changes_with_what_faces_say_and_not_with_how(tmp_path: Path) -> None:
    assert scene_with(tmp_path, ('["tip"]', 0.1)).hash == PLAIN.hash
    together = scene_with(tmp_path, ('["left", "right"]', 0.3))
    apart = scene_with(tmp_path, ('["right"]', 0.3), ('["left"]', 0.3))
    assert together.hash == apart.hash != PLAIN.hash


def test_all_problems_of_faces_are_told_at_once(tmp_path: Path) -> None:
    assert "faces needs schema = 2" in refusal(tmp_path, ('["left"]', 0.2), schema=1)
    twice = refusal(tmp_path, ('["left", "tip"]', 0.2), ('["left", "tip"]', 0.3))
    for face in ("left", "tip"):
        assert f"faces.1.on = {face}: faces.0.on names it already, allowed: each face" in twice
    unknown = refusal(tmp_path, ('["top"]', 0.2), ('["left"]', 0.7))
    assert "'left', 'tip', 'right', 'base' or 'lower'" in unknown
    assert "faces.1.roughness = 0.7: allowed: 0 to 0.5" in unknown
    assert "faces.0.on" in refusal(tmp_path, ("[]", 0.2))
