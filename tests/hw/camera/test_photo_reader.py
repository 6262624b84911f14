"""A folder's photographs are found by their names; each that may be meant is used or named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hw.camera.photo_reader import PhotoReader
from hw.camera.photo_set import save_photos
from hw.errors import CaptureError
from render.scene import load_scene

SCENE = load_scene("finger20")
SIZE = (SCENE.camera.rows, SCENE.camera.columns, 3)


def picture(path: Path, value: int = 40) -> None:
    path.parent.mkdir(exist_ok=True)
    if path.suffix.lower() == ".npy":
        with path.open("wb") as stream:
            np.save(stream, np.full(SIZE, value, dtype=np.uint8))
    else:
        Image.fromarray(np.full(SIZE, value, dtype=np.uint8)).save(path, compress_level=1)


@pytest.mark.parametrize(
    "names",
    [
        ("fiber-00.PNG", "FIBER-01.png", "Dark.PNG", "All.png"),
        ("fiber-0.png", "fiber-1.tif", "dark.tiff", "all.TIF"),
        ("fiber-000.npy", "fiber-001.NPY", "dark.npy", "all.npy"),
    ],
)
def test_names_are_read_as_people_and_programs_write_them(
    tmp_path: Path, names: tuple[str, ...]
) -> None:
    for name in names:
        picture(tmp_path / name, 5 if name.lower().startswith("dark") else 40)
    found = PhotoReader(SCENE).sweep(tmp_path)
    assert sorted(found.alone) == [0, 1]
    assert found.together is not None
    assert found.alone[1][9, 9].tolist() == [35.0] * 3


def test_what_systems_and_people_leave_beside_photographs_is_no_photograph(tmp_path: Path) -> None:
    picture(tmp_path / "fiber-00.png")
    for name in ("._fiber-00.png", ".DS_Store", ".fiber-01.png", "Thumbs.db", "desktop.ini",
                 "notes.txt", "setup.jpg", "allan.jpg"):  # fmt: skip
        (tmp_path / name).write_bytes(b"\0\5\x16\7")
    (tmp_path / "old").mkdir()
    assert list(PhotoReader(SCENE).sweep(tmp_path).alone) == [0]


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("fiber-00.png", "fiber-00.npy"), r"fiber-00\.npy and fiber-00\.png are two photographs"),
        (("fiber-0.png", "fiber-00.png"), r"fiber-0\.png and fiber-00\.png are two photographs"),
        (("fiber-00.PNG", "fiber-00.png"), r"fiber-00\.PNG and fiber-00\.png are two photographs"),
        (("dark.png", "dark.tif", "fiber-00.png"), "two photographs of one name"),
        (("fiber-00.png", "fiber-01 (1).png"), r"fiber-01 \(1\)\.png is no photograph of a sweep"),
        (("fiber-00.png", "fiber_01.png"), r"fiber_01\.png is no photograph of a sweep"),
        (("fiber-00.png", "fiber01.png"), r"fiber01\.png is no photograph of a sweep"),
        (("fiber-00.png", "dark-2.png"), r"dark-2\.png is no photograph of a sweep"),
        (("fiber-00.png", "fiber-20.png"), r"fiber-20\.png is of a fiber that finger20 does not"),
        (("photo-1.png",), "holds no sweep: name its photographs"),
    ],
)
def test_a_name_that_may_be_meant_raises_one_clear_error(
    tmp_path: Path, names: tuple[str, ...], said: str
) -> None:
    for name in names:
        picture(tmp_path / name)
    with pytest.raises(CaptureError, match=said):
        PhotoReader(SCENE).sweep(tmp_path)


@pytest.mark.parametrize("name", ["fiber-01.gif", "fiber-01.webp", "all.heic", "fiber-01.mp4"])
def test_another_form_raises_one_clear_error(tmp_path: Path, name: str) -> None:
    picture(tmp_path / "fiber-00.png")
    (tmp_path / name).write_bytes(b"whatever")
    with pytest.raises(CaptureError, match=f"{name} is no photograph of a sweep, allowed: .*png"):
        PhotoReader(SCENE).sweep(tmp_path)


def test_what_this_program_wrote_has_its_own_full_scale(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dim = np.full(SIZE, 3.0)
    save_photos({"fiber-00": dim}, tmp_path / "sweep")
    found = PhotoReader(SCENE).sweep(tmp_path / "sweep").alone[0]
    np.testing.assert_allclose(found, dim, atol=0.01)
    assert capsys.readouterr().err == ""


def test_a_full_scale_that_was_found_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(0)
    np.save(tmp_path / "fiber-00.npy", rng.integers(0, 3000, SIZE).astype(np.uint16))
    PhotoReader(SCENE).sweep(tmp_path)
    assert "the full scale is taken to be 4095" in capsys.readouterr().err
    PhotoReader(SCENE, full_scale=4000.0).sweep(tmp_path)
    assert capsys.readouterr().err == ""


def test_a_photograph_that_lies_on_its_side_is_named(tmp_path: Path) -> None:
    Image.new("RGB", (SIZE[0], SIZE[1]), (40, 40, 40)).save(tmp_path / "fiber-00.png")
    with pytest.raises(CaptureError, match=r"600 x 360 .* it lies on its side: turn it by 90 deg"):
        PhotoReader(SCENE).sweep(tmp_path)
