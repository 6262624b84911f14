"""Skins from mesh files: heights of the upper side, and bodies that are none."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import trimesh

from render.describe import describe
from render.errors import SceneError
from render.preview import Preview
from render.scene import Scene, load_scene, scene_text, standalone
from tests.oracles.pads import scene_of_case
from tests.oracles.skin_bodies import MIDDLE, RADIUS, SIDES, THICKNESS, body_under, sphere_rise

SPHERE = scene_of_case("mesh")
# Chords of the file's triangles lie this far (mm) under the sphere, and slope by so much less.
SAG, TURN = 5e-4, 5e-3


def scene_on(body: trimesh.Trimesh, folder: Path, name: str = "gel.stl") -> Scene:
    """Return digit with the upper side of ``body`` for a skin."""
    (folder / name).parent.mkdir(exist_ok=True)
    body.export(folder / name)
    text = scene_text("digit") + (
        f'\n[skin]\nshape = "mesh"\nmesh = {{ file = "{name}", source = "CAD" }}\n'
    )
    (folder / "scene.toml").write_text(text)
    return load_scene(folder / "scene.toml")


def flat_block(width: float = 18.3, length: float = 25.0, height: float = 6.15) -> trimesh.Trimesh:
    return body_under(lambda x, _: np.full(x.shape, height), (width, length), 4)


def refusal(body: trimesh.Trimesh, folder: Path) -> str:
    with pytest.raises(SceneError) as caught:
        scene_on(body, folder)
    return str(caught.value)


def test_a_sphere_of_triangles_is_a_sphere_about_its_own_middle() -> None:
    assert SPHERE.skin is not None
    x, y = SPHERE.skin.grid(*SIDES)
    np.testing.assert_allclose(SPHERE.skin.rise(x, y), sphere_rise(x, y), atol=SAG)
    over = RADIUS + sphere_rise(x, y)
    along_x, along_y = SPHERE.skin.slope(x, y)
    np.testing.assert_allclose(along_x, -(x - MIDDLE[0]) / over, atol=TURN)
    np.testing.assert_allclose(along_y, -(y - MIDDLE[1]) / over, atol=TURN)
    assert SPHERE.skin.rise(*MIDDLE) == pytest.approx(0.0, abs=SAG)


def test_a_flat_mesh_has_the_light_of_no_skin(tmp_path: Path) -> None:
    scene, plain = scene_on(flat_block(), tmp_path), load_scene("digit")
    lit = []
    for one in (scene, plain):
        with Preview(one) as preview:
            lit.append(preview.transport(np.array([np.pi / 2]), np.zeros(1))[0])
    # The shader adds light on curved skins up in another order.
    np.testing.assert_allclose(lit[0], lit[1], rtol=0.02, atol=0.002 * lit[1].max())


def test_only_the_upper_side_counts_and_its_height_over_zero_does_not(tmp_path: Path) -> None:
    body = body_under(lambda x, y: THICKNESS + sphere_rise(x, y), (18.3, 25.0), 24)
    low = scene_on(body, tmp_path)
    body.apply_translation([0.0, 0.0, 7.0])
    high = scene_on(body, tmp_path)
    assert low.skin is not None
    assert high.skin is not None
    x, y = low.skin.grid(18.3, 25.0)
    # STL files hold float32.
    np.testing.assert_allclose(high.skin.rise(x, y), low.skin.rise(x, y), atol=5e-6)


def test_bodies_that_are_no_skin_raise_one_clear_error(tmp_path: Path) -> None:
    open_box = flat_block()
    open_box.update_faces(np.arange(len(open_box.faces)) > 0)
    said = refusal(open_box, tmp_path)
    assert "skin.mesh" in said
    assert "gel.stl leaks: 3 of its edges do not join two triangles" in said
    inverted = flat_block()
    inverted.invert()
    assert "is inverted: its volume is -2814 mm^3" in refusal(inverted, tmp_path)
    aside = flat_block()
    aside.apply_translation([1.0, 0.0, 0.0])
    assert "has its middle 1 mm beside the origin" in refusal(aside, tmp_path)
    said = refusal(flat_block(width=20.0), tmp_path)
    assert "skin.mesh is 20 x 25 mm, allowed: the pad's 18.3 x 25 mm" in said
    cylinder = trimesh.creation.cylinder(radius=9.0, height=6.0)
    assert "the upper side ends within the outline, at x = -9, y = -9 mm" in refusal(
        cylinder, tmp_path
    )
    deep = body_under(lambda x, _: 8.0 - 0.9 * np.abs(x), (18.3, 25.0), 24)
    assert "skin.mesh falls to" in refusal(deep, tmp_path)
    cliff = body_under(lambda x, _: 4.0 + 2.0 * np.tanh(20.0 * x), (18.3, 25.0), 96)
    assert "skin.mesh slopes by" in refusal(cliff, tmp_path)


def test_a_file_that_is_no_mesh_raises_one_clear_error(tmp_path: Path) -> None:
    scene_on(flat_block(), tmp_path)
    for content in (b"", b"no mesh at all", bytes(84)):
        (tmp_path / "gel.stl").write_bytes(content)
        with pytest.raises(SceneError, match=r"skin.mesh = .*gel.stl is no body"):
            load_scene(tmp_path / "scene.toml")
    (tmp_path / "gel.stl").unlink()
    with pytest.raises(SceneError, match=r"gel.stl is no body"):
        load_scene(tmp_path / "scene.toml")
    text = (tmp_path / "scene.toml").read_text()
    for wrong in ("{}", '"gel.stl"', '{ file = "gel.stl" }', "{ heights = [0.0] }"):
        (tmp_path / "scene.toml").write_text(
            text.replace('{ file = "gel.stl", source = "CAD" }', wrong)
        )
        with pytest.raises(SceneError, match=r"must be \{ file"):
            load_scene(tmp_path / "scene.toml")


def test_the_mesh_travels_with_its_scene(tmp_path: Path) -> None:
    elsewhere = tmp_path / "there"
    elsewhere.mkdir()
    (tmp_path / "here").mkdir()
    scene = scene_on(flat_block(), tmp_path / "here", name="../there/gel.stl")
    copied = standalone(tmp_path / "here" / "scene.toml")
    for name, content in copied.files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    (tmp_path / "scene.toml").write_text(copied.text)
    assert load_scene(tmp_path / "scene.toml").hash == scene.hash


def test_describe_says_its_size_and_depth() -> None:
    assert "mesh of 20 x 24 mm, down to 4.34 mm under its crown" in describe(SPHERE).text()


def named_parts(body: trimesh.Trimesh) -> str:
    """Return an ASCII STL file with the triangles that face up in one solid, the rest in another.

    Both have the corners of the seam between them.
    """
    upper = body.face_normals[:, 2] > 0.3
    lines = []
    for name, part in (("skin", upper), ("body", ~upper)):
        lines.append(f"solid {name}")
        for normal, corners in zip(body.face_normals[part], body.triangles[part], strict=True):
            lines += [f"facet normal {' '.join(f'{x:.6g}' for x in normal)}", "outer loop"]
            lines += [f"vertex {' '.join(f'{x:.6g}' for x in corner)}" for corner in corners]
            lines += ["endloop", "endfacet"]
        lines.append(f"endsolid {name}")
    return "\n".join(lines) + "\n"


def test_a_closed_body_whose_file_names_its_parts_is_one_body(tmp_path: Path) -> None:
    scene_on(flat_block(), tmp_path)
    parts, hashes = named_parts(flat_block()), []
    for text in (parts, parts.replace("endsolid skin\nsolid body\n", "")):
        (tmp_path / "gel.stl").write_text(text)
        hashes.append(load_scene(tmp_path / "scene.toml").hash)
    assert hashes[0] == hashes[1]


def test_a_hole_between_named_parts_is_still_a_leak(tmp_path: Path) -> None:
    scene_on(flat_block(), tmp_path)
    body = flat_block()
    body.update_faces(np.arange(len(body.faces)) > 0)
    (tmp_path / "gel.stl").write_text(named_parts(body))
    with pytest.raises(SceneError, match="leaks: 3 of its edges do not join two triangles"):
        load_scene(tmp_path / "scene.toml")


def test_a_body_of_another_height_than_the_pad_is_the_same_skin_and_describe_says_both(
    tmp_path: Path,
) -> None:
    """A gel drawn without its plate, and one that floats in its file."""

    def gel(height: float, lift: float = 0.0) -> trimesh.Trimesh:
        # Corners that single precision holds.
        body = body_under(lambda x, _: height - 0.25 * (np.abs(x) > 5.0), (18.3, 25.0), 8)
        return body.apply_translation([0.0, 0.0, lift])

    whole, thin, afloat = (scene_on(gel(*at), tmp_path) for at in ((6.0,), (2.0,), (2.0, 4.0)))
    assert whole.hash == thin.hash == afloat.hash
    for scene, height in ((whole, 6), (thin, 2), (afloat, 2)):
        left_out = {part.what: part.why for part in describe(scene).left_out}
        assert re.fullmatch(
            r"the skin is the upper side alone, 5\.\d+ to 6\.15 mm over the pad's lower face: its "
            rf"crown is at pad\.thickness; the body in its file is {height} mm high",
            left_out["lower side of skin.mesh"],
        )
    assert "lower side of skin.mesh" not in describe(load_scene("digit")).text()


def test_a_body_in_another_unit_is_the_skin_that_fits_the_pad(tmp_path: Path) -> None:
    unit, length = "in", 25.4
    body = body_under(lambda x, y: THICKNESS + sphere_rise(x, y), (18.3, 25.0), 12)
    plain = scene_on(body, tmp_path)
    other = scene_on(body.apply_scale(1.0 / length), tmp_path)
    assert plain.skin is not None
    assert other.skin is not None
    x, y = plain.skin.grid(18.3, 25.0)
    # STL files hold float32.
    np.testing.assert_allclose(other.skin.rise(x, y), plain.skin.rise(x, y), atol=5e-6)
    assert f"under its crown, its file read in {unit}" in describe(other).text()
    assert "its file read in" not in describe(plain).text()
    said = refusal(flat_block(width=20.0).apply_scale(1.0 / length), tmp_path)
    assert "skin.mesh is 20 x 25 mm, allowed: the pad's 18.3 x 25 mm" in said


def test_a_skin_that_looks_down_is_refused_and_not_read_as_a_plane(tmp_path: Path) -> None:
    body = body_under(lambda x, y: THICKNESS + sphere_rise(x, y), (18.3, 25.0), 12)
    body.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [1.0, 0.0, 0.0]))
    said = refusal(body, tmp_path)
    assert "gel.stl lies upside down: it is plane on top and curved by " in said
    assert "turn the body by 180 deg about x or y" in said
    points = flat_block().vertices
    inner = points * [0.95, 0.95, 1.0] - [0.0, 0.0, 0.5]
    chamfered = trimesh.convex.convex_hull(np.concatenate([points, inner[points[:, 2] < 1.0]]))
    assert scene_on(chamfered, tmp_path).skin is not None


def test_triangles_that_face_both_ways_are_named(tmp_path: Path) -> None:
    body = flat_block()
    body.faces[5] = body.faces[5][::-1]
    assert "gel.stl has triangles that face in beside others that face out" in refusal(
        body, tmp_path
    )
