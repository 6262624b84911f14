"""Faces that are rougher or painted: what is read, what is refused, and when a scene is another."""

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


PAINT = {
    "black": "black = true",
    "white": 'white = { value = 0.8, source = "paint" }',
    "mirror": 'mirror = { value = 0.9, source = "silver" }',
}


def painted(folder: Path, names: str, *said: str, bare: bool = False, tip: int = 4) -> Scene:
    """Return finger20 with one entry of faces that says ``said``; ``bare`` without its diffuser."""
    text = TEXT.replace("schema = 1", "schema = 2", 1).replace("tip = 4", f"tip = {tip}", 1)
    if bare:
        head, _, rest = text.partition("[diffuser]")
        text = head + rest[rest.index("[coating]") :]
    path = folder / "scene.toml"
    path.write_text(text + f"\n[[faces]]\non = {names}\n" + "\n".join(said))
    return load_scene(path)


@pytest.mark.parametrize("kind", PAINT)
def test_a_painted_base_is_another_scene_that_travels_as_text(tmp_path: Path, kind: str) -> None:
    scene = painted(tmp_path, '["base"]', PAINT[kind])
    finish = scene.finish("base")
    assert finish.paint is not None
    assert finish.paint.word == kind
    assert finish.white == (kind == "white")
    assert finish.metal == (0.9 if kind == "mirror" else None)
    assert scene.finish("left") == PLAIN.finish("left")
    assert scene_of(scene_content(scene)) == scene
    assert scene.hash != PLAIN.hash


def test_what_absorbs_all_light_is_black_however_it_is_said(tmp_path: Path) -> None:
    hashes = {
        painted(tmp_path, '["base"]', said).hash
        for said in (
            PAINT["black"],
            'white = { value = 0.0, source = "soot" }',
            'mirror = { value = 0.0, source = "soot" }',
        )
    }
    assert len(hashes) == 1
    assert len({painted(tmp_path, '["base"]', said).hash for said in PAINT.values()}) == 3


def test_paint_where_none_can_be_is_refused_with_what_can(tmp_path: Path) -> None:
    def refused(*arguments: object, **changes: object) -> str:
        with pytest.raises(SceneError) as caught:
            painted(tmp_path, *arguments, **changes)  # type: ignore[arg-type]
        return str(caught.value)

    assert "faces.0 names nothing, allowed: one of roughness, black" in refused('["base"]')
    assert "faces.0 names black and white, allowed: one of" in refused(
        '["base"]', PAINT["black"], PAINT["white"]
    )
    assert "faces.0.white = 1.2: allowed: 0 to 1" in refused(
        '["base"]', 'white = { value = 1.2, source = "magic" }'
    )
    assert "faces.0.black = false, allowed: true" in refused('["base"]', "black = false")
    assert "faces.0.on = lower: the camera looks through it" in refused(
        '["lower"]', PAINT["mirror"]
    )
    milky = refused('["tip"]', PAINT["white"])
    assert "faces.0.on = tip: a diffuser lies on that edge, allowed: paint on base" in milky


def test_a_lamp_before_paint_is_refused_with_the_faces_that_are_clear(tmp_path: Path) -> None:
    with pytest.raises(SceneError) as caught:
        painted(tmp_path, '["tip", "base"]', PAINT["mirror"], bare=True)
    assert (
        "fibers.tip shines at the tip face, which is painted (mirror): no light comes in, "
        "allowed: lamps before left, right, lower"
    ) in str(caught.value)
    assert painted(tmp_path, '["tip", "base"]', PAINT["mirror"], bare=True, tip=0).lamp_count == 16


def test_all_problems_of_faces_are_told_at_once(tmp_path: Path) -> None:
    assert "faces needs schema = 2" in refusal(tmp_path, ('["left"]', 0.2), schema=1)
    twice = refusal(tmp_path, ('["left", "tip"]', 0.2), ('["left", "tip"]', 0.3))
    for face in ("left", "tip"):
        assert f"faces.1.on = {face}: faces.0.on names it already, allowed: each face" in twice
    unknown = refusal(tmp_path, ('["top"]', 0.2), ('["left"]', 0.7))
    assert 'faces.0.on.0 = "top", allowed: "left", "tip", "right", "base" or "lower"' in unknown
    assert "faces.1.roughness = 0.7: allowed: 0 to 0.5" in unknown
    assert "faces.0.on" in refusal(tmp_path, ("[]", 0.2))
