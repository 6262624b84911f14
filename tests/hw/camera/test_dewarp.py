"""A fisheye photograph becomes the pinhole's, and bad lens files are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hw.camera.lens import load_lens
from hw.camera.projection import Dewarp
from hw.errors import CaptureError
from render.geometry import pixel_directions
from render.scene import load_scene, unchecked

SCENE = load_scene("finger20")
LENS = """
columns = 640
rows = 480
focal = [200.0, 200.0]
center = [319.5, 239.5]
distortion = [0.05, -0.01, 0.002, 0.0]
"""


def lens_file(tmp_path: Path, text: str = LENS) -> Path:
    path = tmp_path / "lens.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("fisheye", [False, True])
def test_every_direction_lands_where_the_camera_has_it(tmp_path: Path, fisheye: bool) -> None:
    camera = unchecked(SCENE.camera, {"lens": "fisheye"} if fisheye else {})
    scene = unchecked(SCENE, {"camera": camera})
    lens = load_lens(lens_file(tmp_path))
    # A photograph whose color says in which direction each pixel of the fisheye looks.
    x, y = (np.arange(640) - 319.5) / 200, (np.arange(480) - 239.5) / 200
    radius = np.hypot(*np.meshgrid(x, y))
    theta = np.linspace(0, 1.6, 4000)
    bent = theta * (1 + 0.05 * theta**2 - 0.01 * theta**4 + 0.002 * theta**6)
    angle = np.interp(radius, bent, theta)
    photo = np.repeat(angle[..., None], 3, axis=-1)
    found = Dewarp(lens, scene)(photo)[..., 0]
    rows, columns = SCENE.camera.rows, SCENE.camera.columns
    row, column = np.mgrid[0:rows:50, 0:columns:40]
    wanted = np.hypot(column + 0.5 - columns / 2, row + 0.5 - rows / 2) / (rows / 2)
    half = np.radians(55.0)
    wanted = half * wanted if fisheye else np.arctan(np.tan(half) * wanted)
    inside = wanted < 0.9
    np.testing.assert_allclose(found[row, column][inside], wanted[inside], atol=0.005)


@pytest.mark.parametrize("channels", [1, 4, 6])
def test_any_number_of_channels_is_dewarped_alike(tmp_path: Path, channels: int) -> None:
    dewarp = Dewarp(load_lens(lens_file(tmp_path)), SCENE)
    photo = np.random.default_rng(0).uniform(0, 255, (480, 640, channels))
    found = dewarp(photo)
    assert found.shape == (SCENE.camera.rows, SCENE.camera.columns, channels)
    last = dewarp(np.repeat(photo[..., -1:], 3, axis=-1))[..., 0]
    assert np.array_equal(found[..., -1], last)


def test_another_size_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match="640 x 480"):
        Dewarp(load_lens(lens_file(tmp_path)), SCENE)(np.zeros((100, 100, 3)))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("columns = 640", "columns = -1"),
        ("rows = 480\n", ""),
        ("[200.0, 200.0]", "[200.0]"),
        ("[200.0, 200.0]", '["a", 1.0]'),
        ("[0.05,", "[nan,"),
        ("rows = 480", "rows = 480\nzoom = 1"),
        ("rows = 480", "rows = [480"),
    ],
)
def test_a_bad_lens_is_refused(tmp_path: Path, old: str, new: str) -> None:
    with pytest.raises(CaptureError, match=r"lens|zoom"):
        load_lens(lens_file(tmp_path, LENS.replace(old, new)))


def test_the_pinhole_agrees_with_the_renderers_rays() -> None:
    direction = pixel_directions(SCENE, 36, 60, np.array([10.5]), np.array([20.5]))[0]
    focal = 30 / np.tan(np.radians(55.0))
    matrix = np.array([[focal, 0.0, 17.5], [0.0, focal, 29.5], [0.0, 0.0, 1.0]])
    # The renderer's columns run towards -x and rows towards -y.
    seen = matrix @ (np.array([-direction[0], -direction[1], direction[2]]) / direction[2])
    np.testing.assert_allclose(seen[:2], [10.0, 20.0], atol=1e-9)
