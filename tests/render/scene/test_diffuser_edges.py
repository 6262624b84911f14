"""A diffuser on chosen edges: what is read, what is refused, and where lamps and paint may be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from render.errors import SceneError
from render.geometry import flat_fiber_poses
from render.geometry.lamp_poses import mirror_twins
from render.scene import EDGES, Scene, load_scene, scene_content, scene_of, unchecked

TEXT = (Path(__file__).parents[3] / "render" / "scenes" / "finger20.toml").read_text()
PLAIN = load_scene("finger20")
USUAL = '["left", "tip", "right"]'


def scene_with(folder: Path, edges: str, *, schema: int = 2, more: str = "") -> Scene:
    """Return finger20 with ``diffuser.on`` as TOML."""
    text = TEXT.replace("schema = 1", f"schema = {schema}", 1)
    text = text.replace("[diffuser]\n", f"[diffuser]\non = {edges}\n", 1)
    path = folder / "scene.toml"
    path.write_text(text + more)
    return load_scene(path)


def refusal(folder: Path, edges: str, *, schema: int = 2, more: str = "") -> str:
    with pytest.raises(SceneError) as caught:
        scene_with(folder, edges, schema=schema, more=more)
    return str(caught.value)


def test_the_edges_of_every_diffuser_before_have_the_same_hash_named_or_not(tmp_path: Path) -> None:
    assert scene_with(tmp_path, USUAL).hash == PLAIN.hash
    assert scene_with(tmp_path, '["right", "left", "tip"]').hash == PLAIN.hash
    some = scene_with(tmp_path, '["right", "left"]')
    assert some.hash != PLAIN.hash
    assert some.hash == scene_with(tmp_path, '["left", "right"]').hash
    assert some.diffuser_edges == ("left", "right")
    assert scene_of(scene_content(some)) == some


def test_the_silicone_ends_with_the_pad_where_no_layer_lies(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, '["left", "base"]')
    assert scene.box.rims == (2.0, 0.0, 0.0, 2.0)
    np.testing.assert_array_equal(scene.box.low, [-11.0, -17.0, 0.0])
    np.testing.assert_array_equal(scene.box.high, [9.0, 15.0, 4.0])
    assert unchecked(scene, {"diffuser": None}).diffuser_edges == ()


def test_lamps_stand_before_what_lies_on_their_edge(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, '["tip"]')
    poses, edges = flat_fiber_poses(scene), [lamp.edge for lamp in scene.placed_lamps()]
    tip = np.array([edge == "tip" for edge in edges])
    np.testing.assert_array_equal(poses.layer, np.where(tip, 2.0, 0.0))
    np.testing.assert_allclose(poses.gap, 0.4)
    # From the middle of the pad: half its width, or half its length and the layer.
    np.testing.assert_allclose(np.abs(poses.position[~tip, 0]), 9.4)
    np.testing.assert_allclose(poses.position[tip, 1], 17.4)


def test_a_sensor_with_a_layer_on_one_side_is_not_its_own_mirror_image(tmp_path: Path) -> None:
    assert mirror_twins(scene_with(tmp_path, '["left"]')) is None
    assert mirror_twins(scene_with(tmp_path, '["left", "right"]')) is not None
    assert mirror_twins(scene_with(tmp_path, '["tip"]')) is not None


def test_paint_goes_where_no_layer_lies(tmp_path: Path) -> None:
    def paint(face: str) -> str:
        return f'\n[[faces]]\non = ["{face}"]\nblack = true\n'

    assert (
        "faces.0.on = left: a diffuser lies on that edge, allowed: paint on tip, right, base"
        in (refusal(tmp_path, '["left"]', more=paint("left")))
    )
    every = ", ".join(f'"{edge}"' for edge in EDGES)
    assert "allowed: paint on none, as it lies on all" in (
        refusal(tmp_path, f"[{every}]", more=paint("base"))
    )
    # A lamp before it: no layer is there to take its light.
    assert "fibers.tip shines at the tip face, which is painted (black)" in (
        refusal(tmp_path, '["left"]', more=paint("tip"))
    )
    assert scene_with(tmp_path, '["left"]', more=paint("base")).finish("base").paint is not None


@pytest.mark.parametrize(
    ("edges", "said"),
    [
        ("[]", "diffuser.on"),
        ('["left", "left"]', "diffuser.on = left, left names left twice, allowed: each edge once"),
        ('["lower"]', 'diffuser.on.0 = "lower", allowed: "left", "tip", "right" or "base"'),
        ('"left"', 'diffuser.on = "left", allowed: a list'),
    ],
)
def test_edges_that_are_none_are_refused(tmp_path: Path, edges: str, said: str) -> None:
    assert said in refusal(tmp_path, edges)


def test_schema_1_does_not_know_the_key(tmp_path: Path) -> None:
    assert "diffuser.on needs schema = 2" in refusal(tmp_path, USUAL, schema=1)
