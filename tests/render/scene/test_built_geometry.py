"""Lamps cast into the silicone: where they may be, and what a scene without any keeps."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from render.errors import SceneError
from render.geometry import fiber_poses, flat_fiber_poses
from render.scene import Scene, load_scene, scene_text
from tests.oracles.pads import BASE, DOME, MM, RIM, in_file_form, listed, row, window


def scene_with(*lamps: dict[str, Any], **parts: Any) -> Scene:
    """Return the base of ``tests.oracles.pads`` with these lamps, or rows, alone."""
    content: dict[str, Any] = {part: dict(values) for part, values in BASE.items()}
    del content["fibers"]
    content["baseline"] = {"lamps": ["red"] * len(lamps)} if lamps else {}
    for one in parts.get("rows", ()):
        content["baseline"][one["edge"]] = "red"
    thick = parts.pop("thickness", 4.5)
    content["pad"]["thickness"] = (thick, MM)
    content |= ({"lamps": list(lamps)} if lamps else {}) | parts
    return Scene.model_validate({"schema": 2, "name": "case"} | in_file_form(content))


def refusal(*lamps: dict[str, Any], **parts: Any) -> str:
    with pytest.raises(ValueError, match=r".") as caught:
        scene_with(*lamps, **parts)
    return str(caught.value)


@pytest.mark.parametrize(
    ("lamp", "parts", "solid"),
    [
        (listed(0, 0, 2, 0, 0, 1), {}, "pad"),
        (listed(-11, 0, 2, 1, 0, 0), {"diffuser": RIM}, "diffuser"),
        (listed(0, 0, -1, 0, 0, 1), {"window": window(1.49)}, "window"),
        (listed(0, 0, 0.3, 1, 0, 1), {"window": window(1.41)}, "pad"),
        (listed(0, 0, -1, 0, 0, 1), {}, None),
        (listed(-8, 0, 2, 1, 0, 0) | {"turns": True}, {}, "pad"),
    ],
)
def test_a_lamp_is_in_one_solid_or_in_the_air(
    lamp: dict[str, Any], parts: dict[str, Any], solid: str | None
) -> None:
    (placed,) = scene_with(lamp, **parts).placed_lamps()
    assert placed.solid == solid


@pytest.mark.parametrize(
    ("lamp", "parts", "sentence"),
    [
        (listed(-9.5, 0, 2, 0, 1, 0), {}, "is inside the pad, but its end is less than 0.01 mm"),
        (listed(-9.5, 0, 2, 1, 0, 0) | {"turns": True}, {}, "its end when it turns is less than"),
        (listed(0, 0, 0.5, 1, 0, 0), {"window": window(1.49)}, "0.26 mm farther from that border"),
        (listed(-10.4, 0, 2, 0, 1, 0), {"diffuser": RIM}, "is inside the diffuser, but its end"),
        (listed(-11, 0, 2, -1, 0, 0), {"diffuser": RIM}, "shines away from the pad"),
        (listed(-11, 0, 2, 1, 0, 0) | {"turns": True}, {"diffuser": RIM}, "turns"),
        (listed(-12, 0, 2, -1, 0, 0), {}, "shines away from the pad's left face, allowed: a"),
        (listed(0, 3.5, 4.2, 0, 0, 1), {}, "is where the pyramid of site 4 is pressed in"),
        (
            listed(-8, 9, 4.6, 1, 0, 0.2),
            {"skin": DOME, "thickness": 6.0},
            "too high for the skin, allowed: at least 0.01 mm below it",
        ),
    ],
)
def test_where_no_end_can_be_cast_in_is_one_clear_error(
    lamp: dict[str, Any], parts: dict[str, Any], sentence: str
) -> None:
    assert sentence in refusal(lamp, **parts)


def test_rows_are_cast_in_by_a_gap_below_0() -> None:
    rows = [row("left", 2, gap=-1.0), row("tip", 2, gap=-0.7, turns=False)]
    scene = scene_with(rows=rows)
    poses = flat_fiber_poses(scene)
    np.testing.assert_allclose(poses.position[:2, 0], -9.0)
    np.testing.assert_allclose(poses.position[2:, 1], 11.3)
    assert poses.inside.all()
    assert "its end when it turns is less than" in refusal(rows=[row("left", 2, gap=-0.4)])
    # Out of the silicone again, beyond the other edge.
    assert "rows.0.gap = -60 mm is how deep" in refusal(rows=[row("left", 2, gap=-60.0)])


def test_a_row_cast_into_a_diffuser_has_the_rest_of_it_before() -> None:
    scene = scene_with(rows=[row("left", 2, gap=-0.7, turns=False)], diffuser=RIM)
    poses = flat_fiber_poses(scene)
    np.testing.assert_allclose(poses.milky, 1.3)
    np.testing.assert_allclose(poses.layer, 2.0)


def test_a_free_thickness_would_move_a_border_to_a_lamp() -> None:
    free = {"diffuser_thickness": ([1.5, 2.5], MM)}
    assert "free.diffuser_thickness: lamp 0 is cast into the silicone" in refusal(
        listed(-11, 0, 2, 1, 0, 0), diffuser=RIM, free=free
    )


def test_a_lamp_in_the_air_may_shine_along_its_face_or_turn() -> None:
    assert len(scene_with(listed(-12, 0, 2, 0, 1, 0)).placed_lamps()) == 1
    assert len(scene_with(listed(-12, 0, 2, -1, 1, 0) | {"turns": True}).placed_lamps()) == 1


def test_a_touching_lamp_stays_in_the_air() -> None:
    poses = flat_fiber_poses(scene_with(listed(0, 0, 0, 0, 0, 1)))
    assert not poses.inside.any()


def test_lamps_in_the_pad_bend_with_it() -> None:
    scene = scene_with(listed(0, 9, 1.5, 0, 1, 0), bending={"angles": ([0.0, 60.0], "deg")})
    flat, bent = flat_fiber_poses(scene), fiber_poses(scene, np.radians(60.0))
    np.testing.assert_allclose(bent.gap, flat.gap)
    assert np.abs(bent.position - flat.position).max() > 0.5


def test_the_hash_of_a_scene_knows_where_its_lamps_are() -> None:
    inside, below = scene_with(listed(0, 0, 2, 0, 0, 1)), scene_with(listed(0, 0, -2, 0, 0, 1))
    assert inside.hash != below.hash


def test_scene_errors_name_the_lamp() -> None:
    assert "lamps.1 at (-9.9, 0, 2) mm" in refusal(
        listed(0, 0, 2, 0, 0, 1), listed(-9.9, 0, 2, 0, 1, 0)
    )


def test_lamps_of_a_list_are_looked_at_beside_a_row_that_does_not_fit() -> None:
    said = refusal(listed(0, 0, 6, 0, 0, -1), rows=[row("left", 60)])
    assert "rows.0.count = 60 lamps need 60 mm" in said
    assert "lamps.0 at z = 6 mm lies above the pad" in said


def test_the_skin_is_looked_at_beside_a_camera_that_is_wrong() -> None:
    camera = {**BASE["camera"], "field_of_view": (178.0, "deg")}
    said = refusal(
        listed(0, 0, -2, 0, 0, 1), camera=camera, skin={"shape": "dome", "radius": (5.0, MM)}
    )
    assert "camera.field_of_view = 178 deg" in said
    assert "skin.radius = 5 mm" in said


def test_a_lamp_on_the_coating_is_told_of_the_coating() -> None:
    said = refusal(listed(0, 0, 4.5, 1, 0, 0))
    assert "lamps.0 at (0, 0, 4.5) mm lies on the coating, which is opaque" in said


def test_geometry_is_looked_at_beside_a_material_out_of_range(tmp_path: Path) -> None:
    text = scene_text("gelsight-mini")
    mended = re.sub(r"roughness = \{ value = [0-9.]+", "roughness = { value = 0.9", text, count=1)
    mended = re.sub(r"thickness = \{ value = [0-9.]+", "thickness = { value = 1.0", mended, count=1)
    path = tmp_path / "scene.toml"
    path.write_text(mended)
    with pytest.raises(SceneError, match="lies above the pad") as caught:
        load_scene(path)
    assert "pad.roughness = 0.9: allowed: 0 to 0.5; " in str(caught.value)
