"""``tactilux render`` draws what is pressed in, into the file that is named."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from render.choose_exposure import scene_scale
from render.files import read_npz
from render.scene import load_scene

Run = Callable[..., Any]
SIZE = ("--size", "36x60")


def pixels(path: Path) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(path.read_bytes())).convert("RGB")).astype(float)


@pytest.mark.slow
def test_the_default_is_what_the_camera_sees_and_mirror_is_how_reports_draw_it(
    tactilux: Run, tmp_path: Path
) -> None:
    for name, more in (("camera", ()), ("outside", ("--mirror",))):
        done = tactilux("render", *SIZE, "--out", f"{name}.png", *more)
        assert done.code == 0, done.err
        assert done.out == f"{name}.png\n"
    camera, outside = (pixels(tmp_path / f"{name}.png") for name in ("camera", "outside"))
    np.testing.assert_array_equal(camera, outside[:, ::-1])
    # The baseline is red on the left, which a camera below the skin has on its right.
    red = outside[:, :, 0] - outside[:, :, 1]
    assert red[20:50, :18].mean() > 10.0 + red[20:50, 18:].mean()


@pytest.mark.slow
def test_the_kind_of_file_follows_its_name(tactilux: Run, tmp_path: Path) -> None:
    for ending, start in ((".png", b"\x89PNG"), (".JPG", b"\xff\xd8\xff"), (".npz", b"PK")):
        done = tactilux("render", *SIZE, "--out", f"x{ending}")
        assert done.code == 0, done.err
        assert (tmp_path / f"x{ending}").read_bytes().startswith(start)
    linear = read_npz(tmp_path / "x.npz")
    assert linear["radiance"].shape == (60, 36, 3)
    assert linear["exposure"] == scene_scale(load_scene("finger20")).exposure


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--out", ""), ". is a directory: name a file"),
        (("--out", "."), ". is a directory: name a file"),
        (("--out", "x.webp"), "allowed: .png, .jpg, .jpeg, .npz, .exr"),
        (("--out", "file/x.png"), "its place is not a writable directory"),
        (("--size", "36*60"), "such as 240x400"),
        (("--size", "5x60"), "16 to 4096 each"),
        (("--press", "cube"), "allowed: none, pyramids, ball, bolt, edge or a mesh file"),
        (("--press", "file"), "is no body"),
        (("--depth", "0.5"), "depth = 0.5 with press = pyramids, allowed: with ball, bolt, edge"),
        (("--press", "ball", "--depth", "3"), "allowed: less than its radius, 3 mm"),
        (("--press", "bolt", "--depth", "4"), "pressed 4 mm deep does not fit into the pad"),
        (("--press", "edge", "--depth", "0"), "0.01"),
        (("--press", "bolt", "--smooth", "-1"), "-1, allowed: at least 0"),
        (("--minutes", "1"), "a preview has none"),
        (("--level", "reference", "--minutes", "1", "--samples", "2"), "not both"),
    ],
)
def test_what_cannot_be_drawn_or_written_is_said_before_anything_is_drawn(
    tactilux: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: tuple[str, ...], said: str
) -> None:
    (tmp_path / "file").write_text("no mesh")
    monkeypatch.setattr("render.preview.Preview.__init__", lambda *_, **__: pytest.fail("drawn"))
    done = tactilux("render", *more)
    assert done.code == 2
    assert said in " ".join(done.err.split())
    assert {item.name for item in tmp_path.iterdir()} == {"file"}


def pressed_pixels(folder: Path, tactilux: Run, press: str, *more: object) -> np.ndarray:
    """Return how bright the picture is with a body pressed in, over that without."""
    light = []
    for name, options in (("none", more[:2]), (press, more)):
        done = tactilux("render", "--press", name, "--out", "x.npz", *options)
        assert done.code == 0, done.err
        light.append(read_npz(folder / "x.npz")["radiance"].sum(axis=-1))
    return np.asarray(light[1] / np.where(light[0] > 0, light[0], np.nan))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("press", "more"),
    [
        ("ball", ()),
        ("bolt", ("--depth", 0.6)),
        ("pyramids", ()),
        ("edge", ()),
        ("edge", ("--smooth", 0.2)),
        ("box.stl", ("--depth", 0.8)),
    ],
)
def test_a_body_shows_where_it_is_pressed_in(
    tactilux: Run, tmp_path: Path, press: str, more: tuple[object, ...]
) -> None:
    trimesh.creation.box((6.0, 3.0, 2.0)).export(tmp_path / "box.stl")
    changed = np.abs(pressed_pixels(tmp_path, tactilux, press, *SIZE, *more) - 1.0)
    row, column = np.unravel_index(np.nanargmax(changed), changed.shape)
    assert changed[row, column] > 0.1
    assert abs(column - 17.5) < 9.0
    # Far from all of them the coating is as it was.
    assert np.nanmax(changed[50:, :4]) < 0.05


@pytest.mark.slow
def test_minutes_end_a_picture_of_the_reference(tactilux: Run, tmp_path: Path) -> None:
    done = tactilux(
        "render", "--level", "reference", "--minutes", "0.1", "--size", "18x30", "--out", "x.exr"
    )
    assert done.code == 0, done.err
    assert "Noise of a pixel" in done.err
    assert (tmp_path / "x.exr").read_bytes()[:4] == b"\x76\x2f\x31\x01"
