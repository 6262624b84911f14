"""Units of mesh files: named in a remark, found by the size of the pad, or asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from render.errors import SceneError
from render.files import MEGABYTE
from render.geometry import HeightMap, probe
from render.mesh_file import read_mesh
from render.mesh_units import UNITS, Unit
from render.scene import Scene, load_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


def ball(folder: Path, unit: Unit, radius: float = 40.0, kind: str = "stl") -> Path:
    """Return a file of a ball of ``radius`` (mm) whose numbers are in ``unit``."""
    body = trimesh.creation.icosphere(subdivisions=5, radius=radius / UNITS[unit])
    body.export(folder / f"{unit}.{kind}")
    return folder / f"{unit}.{kind}"


def pressed(scene: Scene, path: Path, unit: Unit | None = None) -> HeightMap:
    skin = probe(scene, str(path), 0.5, 0.0, unit)
    assert isinstance(skin, HeightMap)
    return skin


@pytest.mark.parametrize(
    ("unit", "kind"), [("mm", "stl"), ("cm", "ply"), ("m", "obj"), ("in", "stl"), ("um", "ply")]
)
def test_a_ball_of_80_mm_is_one_in_every_unit(
    scene: Scene, tmp_path: Path, unit: Unit, kind: str
) -> None:
    """Its contact circle has the area of a cap 0.5 mm deep, pi (2 r d - d^2)."""
    skin = pressed(scene, ball(tmp_path, unit, kind=kind), unit)
    area = (skin.depth > 0).sum() * np.prod(skin.step)
    assert area == pytest.approx(np.pi * (80.0 * 0.5 - 0.25), rel=0.02)
    assert f"is 80 x 80 x 80 mm in {unit}, as given" in skin.about


@pytest.mark.parametrize("unit", ["mm", "m", "um"])
def test_a_unit_that_alone_fits_the_pad_is_found_and_said(
    scene: Scene, tmp_path: Path, unit: Unit
) -> None:
    skin = pressed(scene, ball(tmp_path, unit))
    assert (
        skin.about == f"{unit}.stl is 80 x 80 x 80 mm in {unit}, by its size: give unit for another"
    )
    assert (skin.depth > 0).sum() * np.prod(skin.step) > 100.0


def test_a_body_that_may_be_in_two_units_says_the_other(scene: Scene, tmp_path: Path) -> None:
    skin = pressed(scene, ball(tmp_path, "in"))
    assert "is 3.15 x 3.15 x 3.15 mm in mm (31.5 if in cm, 80 if in in)" in skin.about
    assert "if in" not in pressed(scene, ball(tmp_path, "mm", 8.0)).about


@pytest.mark.parametrize("unit", ["in", "cm"])
def test_a_fingertip_too_small_for_mm_is_asked_for_its_unit(
    scene: Scene, tmp_path: Path, unit: Unit
) -> None:
    path = ball(tmp_path, unit, {"in": 8.0, "cm": 5.0}[unit])
    with pytest.raises(SceneError, match=r"does not say its unit, and .* give unit, mm \(") as said:
        pressed(scene, path)
    assert said.value.field == "unit"
    for word in ("mm (", "cm (", "m (", "in (", "um ("):
        assert word in str(said.value)


def test_a_dot_that_presses_nothing_names_its_unit(scene: Scene, tmp_path: Path) -> None:
    tip = trimesh.Trimesh([[0.0, 0.0, 0.0], [0.01, 0.0, 2.0], [0.01, 1e-4, 1.0]], [[0, 1, 2]])
    tip.export(tmp_path / "tip.stl")
    with pytest.raises(
        SceneError, match=r"presses nothing, .*; tip\.stl is .* mm in mm .*, as given"
    ):
        pressed(scene, tmp_path / "tip.stl", "mm")


@pytest.mark.parametrize(
    ("kind", "remark"),
    [
        ("obj", "# Units: inches"),
        ("obj", "#   File units = in"),
        ("obj", "# units are in inches"),
        ("ply", "comment unit: inch"),
        ("stl", "solid ball units=inches"),
    ],
)
def test_a_remark_in_the_file_names_its_unit(
    scene: Scene, tmp_path: Path, kind: str, remark: str
) -> None:
    body = trimesh.creation.icosphere(subdivisions=3, radius=40.0 / 25.4)
    form = {"stl": "stl_ascii"}.get(kind, kind)
    content = body.export(file_type=form, **({"encoding": "ascii"} if kind == "ply" else {}))
    text = content.decode() if isinstance(content, bytes) else content
    if kind == "ply":
        text = text.replace("format ascii 1.0\n", f"format ascii 1.0\n{remark}\n")
    elif kind == "stl":
        text = remark + text[text.index("\n") :]
    else:
        text = f"{remark}\n{text}"
    (tmp_path / f"ball.{kind}").write_text(text)
    about = pressed(scene, tmp_path / f"ball.{kind}").about
    assert about == f"ball.{kind} is 80 x 80 x 80 mm in in, as it says"


def test_a_unit_is_for_files(scene: Scene) -> None:
    with pytest.raises(SceneError, match="unit = m with press = ball, allowed: with a mesh file"):
        probe(scene, "ball", unit="m")


@pytest.mark.parametrize("name", ["mesh.zip", "mesh.gltf", "mesh.stl.gz", "mesh"])
def test_other_kinds_of_files_are_not_opened(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"PK\x03\x04")
    with pytest.raises(
        ValueError, match=r"is no body: it ends in .*, allowed: \.stl, \.ply, \.obj"
    ):
        read_mesh(tmp_path / name)


def test_a_file_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with (tmp_path / "large.stl").open("wb") as stream:
        stream.truncate(10**11)
    with pytest.raises(
        ValueError, match=r"is no body: it has 100,000,000,000 bytes, allowed: up to 64,000,000"
    ):
        read_mesh(tmp_path / "large.stl")


PROMISE = "ply\nformat {} 1.0\nelement vertex 1000000000\nproperty float x\nend_header\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.stl", bytes(80) + (10**9).to_bytes(4, "little") + bytes(50)),
        ("a.ply", PROMISE.format("ascii").encode() + b"0\n"),
        ("a.ply", PROMISE.format("binary_little_endian").encode() + bytes(100)),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 1000000000\n"),
    ],
)
def test_what_a_header_promises_and_the_file_lacks_takes_no_memory(
    tmp_path: Path, name: str, content: bytes
) -> None:
    import tracemalloc

    (tmp_path / name).write_bytes(content)
    tracemalloc.start()
    with pytest.raises(ValueError, match="is no body that can be read"):
        read_mesh(tmp_path / name)
    assert tracemalloc.get_traced_memory()[1] < MEGABYTE
    tracemalloc.stop()


def test_materials_and_pictures_beside_a_mesh_are_not_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from PIL import Image

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a picture was opened")

    Image.new("RGB", (4, 4)).save(tmp_path / "a.png")
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd a.png\n")
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\n"
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\nusemtl a\n{corners}f 1/1 2/1 3/1\n")
    monkeypatch.setattr(Image, "open", refuse)
    assert len(read_mesh(tmp_path / "a.obj")[0].faces) == 1


@pytest.mark.parametrize("remark", ["# Units in mm", "# units are in millimeters", "# units of mm"])
def test_units_in_mm_are_no_inches(tmp_path: Path, remark: str) -> None:
    body = trimesh.creation.icosphere(subdivisions=1, radius=2.0)
    (tmp_path / "ball.obj").write_text(f"{remark}\n{body.export(file_type='obj')}")
    assert read_mesh(tmp_path / "ball.obj")[1] == "mm"
