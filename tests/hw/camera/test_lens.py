"""Lenses of OpenCV, ROS and our own files project as OpenCV's functions and the papers do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hw.camera.lens import Lens, load_lens
from hw.camera.photo_reader import PhotoReader
from hw.camera.photo_set import save_photos
from hw.camera.projection import Dewarp
from hw.errors import CaptureError
from render.arrays import Array
from render.scene import load_scene

cv2 = pytest.importorskip("cv2")

PLUMB_BOB = (-0.28, 0.07, 0.0011, -0.0007, 0.012)
RATIONAL = (0.35, -0.08, 0.0004, -0.0009, 0.01, 0.62, -0.11, 0.03)
FISHEYE = (0.05, -0.01, 0.002, 0.0005)
MATRIX = "[431.5, 0., 317.25, 0., 432.5, 241.75, 0, 0, 1.0]"
ROS = """
image_width: 640
image_height: 480
camera_name: head_camera
camera_matrix:
  rows: 3
  cols: 3
  data: {matrix}
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: {count}
  data: {data}
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
"""


def ros(model: str, distortion: tuple[float, ...]) -> str:
    return ROS.format(matrix=MATRIX, model=model, count=len(distortion), data=[*distortion])


def directions() -> Array:
    x, y = np.meshgrid(np.linspace(-0.7, 0.7, 9), np.linspace(-0.5, 0.5, 7))
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def by_the_formula(distortion: tuple[float, ...]) -> Array:
    """Return pixels by Brown's terms and the rational ones, as OpenCV's manual prints them."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (*distortion, *[0.0] * (8 - len(distortion)))
    x, y = directions()[..., 0], directions()[..., 1]
    r2 = x**2 + y**2
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([431.5 * u + 317.25, 432.5 * v + 241.75], axis=-1)


def opened(tmp_path: Path, text: str, name: str = "lens.yaml") -> Lens:
    (tmp_path / name).write_text(text)
    return load_lens(tmp_path / name)


@pytest.mark.parametrize(
    ("model", "distortion"), [("plumb_bob", PLUMB_BOB), ("rational_polynomial", RATIONAL)]
)
def test_a_pinhole_of_ros_projects_by_the_formula_and_back(
    tmp_path: Path, model: str, distortion: tuple[float, ...]
) -> None:
    lens = opened(tmp_path, ros(model, distortion))
    found = lens.positions(directions())
    np.testing.assert_allclose(found, by_the_formula(distortion), atol=1e-6)
    matrix = np.array([[431.5, 0, 317.25], [0, 432.5, 241.75], [0, 0, 1]])
    back = cv2.undistortPoints(found.reshape(-1, 1, 2), matrix, np.array(distortion))
    wanted = directions()[..., :2].reshape(-1, 2)
    np.testing.assert_allclose(back.reshape(-1, 2), wanted, atol=2e-3)


def test_a_fisheye_projects_as_opencv_does(tmp_path: Path) -> None:
    lens = opened(tmp_path, ros("equidistant", FISHEYE))
    matrix = np.array([[431.5, 0, 317.25], [0, 432.5, 241.75], [0, 0, 1]])
    points = directions().reshape(-1, 1, 3)
    wanted, _ = cv2.fisheye.projectPoints(
        points, np.zeros(3), np.zeros(3), matrix, np.array(FISHEYE)
    )
    np.testing.assert_allclose(
        lens.positions(points).reshape(-1, 2), wanted.reshape(-1, 2), atol=1e-6
    )


@pytest.mark.parametrize("model", ["pinhole", "fisheye"])
def test_what_opencv_writes_is_read(tmp_path: Path, model: str) -> None:
    path = tmp_path / "opencv.yml"
    distortion = PLUMB_BOB if model == "pinhole" else FISHEYE
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", 640)
    file.write("image_height", 480)
    if model == "fisheye":
        file.write("fisheye_model", 1)
    file.write("camera_matrix", np.array([[431.5, 0, 317.25], [0, 432.5, 241.75], [0, 0, 1]]))
    file.write("distortion_coefficients", np.array(distortion)[:, None])
    file.release()
    assert load_lens(path) == Lens(640, 480, (431.5, 432.5), (317.25, 241.75), distortion, model)


def test_our_toml_holds_a_pinhole_too(tmp_path: Path) -> None:
    text = (
        "columns = 640\nrows = 480\nfocal = [431.5, 432.5]\ncenter = [317.25, 241.75]\n"
        f'model = "pinhole"\ndistortion = {[*PLUMB_BOB]}\n'
    )
    lens = opened(tmp_path, text, "lens.toml")
    np.testing.assert_allclose(lens.positions(directions()), by_the_formula(PLUMB_BOB), atol=1e-6)


def test_a_topic_of_ros_is_read(tmp_path: Path) -> None:
    text = (
        f"height: 480\nwidth: 640\ndistortion_model: plumb_bob\nd:\n- -28e-2\n- 0.07\n- 0.0011\n"
        f"- -0.0007\n- 0.012\nk: {MATRIX}\n---\n"
    )
    assert opened(tmp_path, text).distortion == PLUMB_BOB


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (ros("field_of_view", (0.9,)), "its model is 'field_of_view', allowed: fisheye,"),
        (ros("plumb_bob", (0.1, 0.2)), "allowed: a list of 4 or 5 or 8"),
        (ros("plumb_bob", PLUMB_BOB).replace("0.07", ".nan"), "finite numbers"),
        (ros("plumb_bob", PLUMB_BOB).replace("431.5, 0.", "431.5, 2."), "a skew of 2"),
        (ros("plumb_bob", PLUMB_BOB).replace("431.5", "-431.5"), "the focal length is -431.5"),
        (ros("plumb_bob", PLUMB_BOB).replace("image_width: 640\n", ""), "columns is missing"),
        (ros("x", FISHEYE).replace("distortion_model: x\n", ""), "a fisheye's or a pinhole's"),
        ("image_width: [1", "cannot be read as a lens"),
        ("- 1\n- 2\n", "it holds no keys"),
        ("a: " + "[" * 5000, "cannot be read as a lens"),
        ("a: !!python/object/apply:os.getcwd []", "cannot be read as a lens"),
    ],
)
def test_a_wrong_file_raises_one_clear_error(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(CaptureError, match="lens") as error:
        opened(tmp_path, text)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_polynomial_that_folds_back_on_the_pad_raises_one_clear_error() -> None:
    scene = load_scene("finger20")
    folding = Lens(640, 640, (300.0, 300.0), (319.5, 319.5), (-0.4, 0.0, 0.0, 0.0), "pinhole")
    with pytest.raises(CaptureError, match=r"% of the pad lie outside the photograph or where"):
        Dewarp(folding, scene)


def test_a_lens_is_undone_in_files_once(tmp_path: Path) -> None:
    scene = load_scene("finger20")
    text = (
        "columns = 500\nrows = 500\nfocal = [150.0, 150.0]\ncenter = [249.5, 249.5]\n"
        'model = "pinhole"\ndistortion = [-0.05, 0.01, 0.001, 0.0, 0.0]\n'
    )
    lens = opened(tmp_path, text, "lens.toml")
    y, x = np.mgrid[0:500, 0:500]
    photo = np.repeat(np.rint(40 + x / 5 + y / 10)[..., None], 3, axis=-1).astype(np.uint8)
    np.save(tmp_path / "fiber-00.npy", photo)
    found = PhotoReader(scene, lens=tmp_path / "lens.toml").sweep(tmp_path).alone[0]
    np.testing.assert_allclose(found, Dewarp(lens, scene)(photo.astype(float)))
    save_photos({"fiber-00": found}, tmp_path / "undone", dewarped=True)
    with pytest.raises(CaptureError, match="captured with its lens undone: leave --lens out"):
        PhotoReader(scene, lens=tmp_path / "lens.toml").sweep(tmp_path / "undone")
