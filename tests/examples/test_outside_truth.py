"""Outside truth: typed means of photographs, devices made up of known rings, and the command.

Of the pictures of others only these numbers are here; docs/outside-truth.md says how to get them.
"""

from __future__ import annotations

import math
import sys
from dataclasses import astuple
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

import tactilux

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))

import outside_truth
from truth import cmu, gssim
from truth.comparison import between, by_color, off, previewed, touched

pytestmark = pytest.mark.slow

PAGE = (Path(__file__).parents[2] / "docs" / "outside-truth.md").read_text(encoding="utf-8")

# x, y (mm), red, green, blue of untouched skin in tri0u.exr of
# github.com/CMURoboTouch/tactile_optical_simulation: means of squares of 1.5 mm, linear.
SKIN = np.array([
    [2.46, 5.36, 0.085, 0.059, 0.134], [0.93, 5.36, 0.095, 0.064, 0.149],
    [-0.59, 5.36, 0.099, 0.061, 0.158], [-2.12, 5.36, 0.100, 0.058, 0.167],
    [-3.65, 5.43, 0.089, 0.055, 0.181], [-5.17, 5.36, 0.071, 0.050, 0.190],
    [2.46, 3.84, 0.084, 0.072, 0.151], [0.93, 3.84, 0.096, 0.072, 0.156],
    [-0.53, 3.95, 0.102, 0.066, 0.156], [-5.17, 3.84, 0.071, 0.058, 0.239],
    [2.51, 2.36, 0.082, 0.084, 0.155], [-5.17, 2.31, 0.065, 0.065, 0.280],
    [2.56, 0.65, 0.068, 0.097, 0.169], [-5.17, 0.78, 0.058, 0.072, 0.325],
    [2.46, -0.74, 0.060, 0.099, 0.182], [0.95, -0.76, 0.055, 0.095, 0.206],
    [-5.17, -0.74, 0.050, 0.076, 0.337], [2.46, -2.27, 0.053, 0.106, 0.187],
    [0.93, -2.27, 0.054, 0.094, 0.209], [-0.59, -2.27, 0.049, 0.086, 0.233],
    [-2.05, -2.38, 0.041, 0.084, 0.276], [-5.17, -2.27, 0.041, 0.079, 0.354],
])  # fmt: skip
# The strongest contrasts of the prism's sides (red, blue, green) in each channel, same picture.
PEAKS = np.array([[0.39, -0.25, -0.50], [-0.29, -0.16, 0.49], [-0.50, 0.23, -0.10]])


@pytest.fixture(scope="module")
def flat() -> tactilux.Scene:
    return tactilux.load_scene("gelsight-flat")


def skin_off(flat: tactilux.Scene, turn: float | None) -> float:
    """Return how far the preview is off the photograph, with its lamps turned (deg)."""
    scene = flat if turn is None else cmu.wrong(flat, turn, 1.0)
    scene = touched(scene, {"columns": 5, "rows": 5, "spacing": 2.3}, faces=3)
    seen = between(scene, by_color(scene, previewed(scene)[1]), SKIN[:, 0], SKIN[:, 1])
    return off(seen, SKIN[:, 2:])


def test_the_skin_of_gelsight_flat_is_that_of_a_photograph(flat: tactilux.Scene) -> None:
    assert skin_off(flat, None) < 0.15
    assert skin_off(flat, 60.0) > 0.30


def test_the_preview_of_gelsight_flat_is_the_inverse_square_law(flat: tactilux.Scene) -> None:
    """Irradiance of Lambertian disks in air: cos cos / (pi r^2), summed over rings."""
    scene = touched(flat, {"columns": 4, "rows": 4, "spacing": 3.5}, faces=3)
    _, sites = previewed(scene)
    x, y = (axis[:, None, None] for axis in gssim.places(scene))
    angle = 2 * np.pi * (np.arange(24) + 0.5) / 24
    radius = np.sqrt((np.arange(12) + 0.5) / 12)
    for lamp, seen in zip(flat.lamps or (), sites, strict=True):
        beam = np.array(lamp.direction) / np.linalg.norm(lamp.direction)
        side = np.cross(beam, [0.0, 0.0, 1.0])
        side /= np.linalg.norm(side)
        across = np.stack([side, np.cross(beam, side)])
        ring = lamp.diameter / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ across
        ends = np.array(lamp.position) + radius[:, None, None] * ring
        ray = np.stack(np.broadcast_arrays(x, y, 2.0), axis=-1) - ends
        cosine = np.maximum(ray @ beam, 0.0) * ray[..., 2]
        irradiance = (cosine / (ray**2).sum(axis=-1) ** 2).mean(axis=(1, 2)) / np.pi
        np.testing.assert_allclose(seen, irradiance * 0.45 / np.pi, rtol=2e-3)


def test_faces_of_the_prism_have_the_contrasts_of_the_photograph(flat: tactilux.Scene) -> None:
    right = cmu.facet_contrasts(flat, previewed)
    assert (np.sign(right) == np.sign(PEAKS)).all()
    assert np.corrcoef(right.ravel(), PEAKS.ravel())[0, 1] > 0.85
    turned = cmu.facet_contrasts(cmu.wrong(flat, 60.0, 1.0), previewed)
    assert (np.sign(turned) == np.sign(PEAKS)).sum() < 5


def test_contrasts_are_read_from_a_picture_with_a_prism() -> None:
    """A gray picture whose three sides are brighter or darker by a known share."""
    name, half = "tri0u", np.full((600, 600, 3), 0.5)
    row, column = np.mgrid[:600, :600]
    for number in range(3):
        start, _, normal = cmu.side(name, number)
        away = (np.stack([column, row], axis=-1) - start) @ normal
        half[np.abs(away) < 8] *= 1 + PEAKS[number]
    np.testing.assert_allclose(cmu.peaks(half, name), PEAKS, atol=0.02)


MADE_UP = ("made_up", "larger")


def write_device(folder: Path, name: str, ring: gssim.Ring) -> None:
    """Write a device of Lambertian lamps in the form of gssim, one pixel to 0.02 mm."""
    rows, columns = 320, 400
    x = (np.arange(columns) + 0.5 - columns / 2) * 0.02
    y = (rows / 2 - np.arange(rows) - 0.5) * 0.02
    fields = [ring.irradiance(number, *np.meshgrid(x, y)) for number in range(6)]
    tiles = np.concatenate([np.concatenate(fields[i : i + 3], axis=1) for i in (0, 3)])
    values = (60000 * tiles / tiles.max()).astype(np.uint16)
    mi.Bitmap(values[..., None]).write(str(folder / f"{name}.png"))
    quadratic = np.zeros((6, 6, 10))
    for number in range(6):
        place, _ = ring.lamp(number)
        # b of b . n, the last row of the polynomials: towards the lamp, 1 for the flat pad.
        quadratic[-1, number, 6:9] = place * [1, 1, -1] / ring.height
    listed = ", ".join(map(str, quadratic.ravel()))
    (folder / f"{name}.yaml").write_text(
        f"width: 800\nmmperpixel: 0.01\nlinfit: \n    values: [1, 2]\n"
        f"quadfit: \n    rows: 6\n    cols: 60\n    values: [{listed}]\n"
    )


@pytest.mark.usefixtures("variant_kept")
def test_rings_of_lamps_of_one_aim_are_found_by_two_lights_of_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mi.set_variant("scalar_rgb")
    (tmp_path / "devices").mkdir()
    rings = [
        gssim.Ring(11.0, 7.0, math.radians(-10.0), 1.6, -math.pi / 3),
        gssim.Ring(14.0, 11.0, math.radians(-10.0), -0.4, math.pi / 3),
    ]
    for name, ring in zip(MADE_UP, rings, strict=True):
        write_device(tmp_path / "devices", name, ring)
    found = gssim.Ring.fitted([gssim.Device.read(tmp_path, name) for name in MADE_UP])
    np.testing.assert_allclose(
        [astuple(ring) for ring in found], [astuple(ring) for ring in rings], rtol=0.02
    )
    monkeypatch.setattr(gssim, "DEVICES", MADE_UP)
    background, slope, *others = gssim.rows(tmp_path, previewed)
    assert background.met
    assert background.found < 0.01
    assert background.controls["next light"] > 0.1
    assert slope.found < 0.03
    assert len(others) == 2


def test_digit_has_red_left_and_fading_as_in_its_photograph() -> None:
    """The photograph's red falls 11-fold over all rows, 17-fold along its own."""
    found = outside_truth.layout(outside_truth.drawn_digit(previewed, "digit"))
    assert found["red left of green"] > 0
    assert found["red falls, all rows"] > 5
    assert found["red falls, its rows"] > 5


def test_digit_dome_has_red_left_and_fading_but_not_along_its_brightest_rows() -> None:
    """These rows are not as in the photograph, says the page; mirrored, all is wrong."""
    drawn = outside_truth.drawn_digit(previewed, "digit-dome")
    found, mirrored = (outside_truth.layout(picture) for picture in (drawn, drawn[:, ::-1]))
    assert found["red left of green"] > 0.1
    assert found["red falls, all rows"] > 5
    assert found["red falls, its rows"] < 3
    assert mirrored["red left of green"] < -0.1
    assert mirrored["red falls, all rows"] < 2


def test_layout_reads_a_picture_with_red_left() -> None:
    fall = np.geomspace(8.0, 1.0, 24)
    picture = np.stack([fall, fall[::-1], np.ones(24)], axis=-1) * np.ones((32, 1, 1))
    found = outside_truth.layout(picture)
    assert found["red left of green"] > 0.2
    assert found["red falls, all rows"] == pytest.approx(8.0)
    assert outside_truth.layout(picture[:, ::-1])["red left of green"] < -0.2


def test_what_is_not_there_is_said_with_how_to_get_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # Nothing that was compared is no goal that was met.
    assert outside_truth.main([str(tmp_path / "absent")]) == 2
    assert outside_truth.main([str(tmp_path)]) == 2
    said = capsys.readouterr().out
    assert f"Nothing could be compared: {tmp_path} holds none of tactile_optical_simulation" in said
    for name, (owner, licence) in outside_truth.SOURCES.items():
        address = f"git clone https://github.com/{owner}/{name}"
        assert address in said
        assert address in PAGE
        assert licence in said
