"""The drawing of a sensor shows what the scene has, where it is."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from render.geometry import counted_sites, declared_sites, flat_fiber_poses
from render.scene import Camera, Scene, load_scene, unchecked
from render.sensor_drawing import sensor_svg
from tests.oracles.pads import scene_of_case

SCENE = load_scene("finger20")
SVG = "{http://www.w3.org/2000/svg}"


def panels(text: str) -> list[ElementTree.Element]:
    """Return the views of a drawing."""
    return ElementTree.fromstring(text).findall(f"{SVG}g")


def spots(panel: ElementTree.Element, kind: str) -> np.ndarray:
    found = [
        (float(e.attrib["cx"]), float(e.attrib["cy"]))
        for e in panel.iter(f"{SVG}circle")
        if e.attrib.get("class") == kind
    ]
    return np.array(found)


def test_sites_stand_in_both_views_where_they_are_on_the_pad() -> None:
    outside, section = panels(sensor_svg(SCENE))
    sites = declared_sites(SCENE)
    for panel, axis in ((outside, 0), (section, 2)):
        drawn = spots(panel, "site")
        wanted = np.stack([sites[:, axis], -sites[:, 1]], axis=-1)
        # The scale is 1 mm a unit: the same up to one shift.
        np.testing.assert_allclose(np.ptp(drawn - wanted, axis=0), 0.0, atol=2e-3)
    np.testing.assert_allclose(spots(outside, "site")[:, 1], spots(section, "site")[:, 1])


def test_every_lamp_has_its_number_and_the_color_that_it_is_given() -> None:
    inks = [f"#{number:06x}" for number in range(20)]
    text = sensor_svg(SCENE, np.full(20, 1.0), inks, section=False)
    (outside,) = panels(text)
    numbers = {e.text for e in outside.iter(f"{SVG}text")} - {"from outside"}
    assert numbers == {str(number) for number in range(20)}
    cones = [e for e in outside.iter(f"{SVG}path") if e.attrib["class"] == "colored cone"]
    assert [cone.attrib["fill"] for cone in cones] == inks
    # A cone leads from its lamp along its beam: from the middle of its first two corners.
    beams = flat_fiber_poses(SCENE).directions(np.full(20, 1.0))[:, :2]
    for cone, beam in zip(cones, beams, strict=True):
        corner = np.array(re.findall(r"-?[\d.]+", cone.attrib["d"]), dtype=float).reshape(-1, 2)
        way = corner[2:].mean(axis=0) - corner[:2].mean(axis=0)
        np.testing.assert_allclose(
            way / np.linalg.norm(way), beam / np.linalg.norm(beam) * [1, -1], atol=2e-3
        )


def test_lamps_that_are_off_are_small_circles() -> None:
    inks = [None if number < 12 else "#ff0000" for number in range(20)]
    (outside,) = panels(sensor_svg(SCENE, np.full(20, 1.0), inks, section=False))
    numbers = {e.text for e in outside.iter(f"{SVG}text")} - {"from outside"}
    assert numbers == {str(number) for number in range(12, 20)}
    places = spots(outside, "dark") - flat_fiber_poses(SCENE).position[:12, :2] * [1, -1]
    np.testing.assert_allclose(np.ptp(places, axis=0), 0.0, atol=2e-3)
    colors = [*["off"] * 8, *["red"] * 4]
    baseline = unchecked(SCENE.baseline, {"left": tuple(colors[:8]), "tip": tuple(colors[8:])})
    (outside,) = panels(sensor_svg(unchecked(SCENE, {"baseline": baseline}), section=False))
    assert len(spots(outside, "dark")) == 8


def test_sites_that_do_not_count_are_crosses() -> None:
    camera = unchecked(SCENE.camera, {"field_of_view": np.radians(45.0)})
    scene = unchecked(SCENE, {"camera": camera})
    few = len(counted_sites(scene))
    outside = panels(sensor_svg(scene))[0]
    crosses = [e for e in outside.iter(f"{SVG}path") if e.attrib["class"] == "out"]
    assert 0 < few < 15
    assert len(spots(outside, "site")) == few
    assert len(crosses) == 15 - few


def test_what_the_camera_sees_is_drawn_on_the_skin() -> None:
    camera = unchecked(SCENE.camera, {"field_of_view": np.radians(60.0)})
    outside = panels(sensor_svg(unchecked(SCENE, {"camera": camera})))[0]
    (view,) = [e for e in outside.iter(f"{SVG}path") if e.attrib["class"] == "view"]
    corner = np.array(re.findall(r"-?[\d.]+", view.attrib["d"]), dtype=float).reshape(-1, 2)
    # The middle of the upper border: 30 deg from the axis, then by Snell's law.
    inside = np.arcsin(np.sin(np.radians(30.0)) / 1.41)
    half = 10.0 * np.tan(np.radians(30.0)) + 4.0 * np.tan(inside)
    lens = spots(outside, "lens")[0]
    column = np.abs(corner[:, 0] - lens[0]) < 1e-3
    np.testing.assert_allclose(np.ptp(corner[column, 1]) / 2, half, atol=2e-3)


@pytest.mark.parametrize(
    "camera",
    [
        {"position": (3.0, -12.0, -60.0), "look_at": (0.0, 2.0, 4.0)},
        {"position": (0.0, 3.0, -6.0), "lens": "fisheye", "field_of_view": np.radians(200.0)},
    ],
)
def test_any_camera_is_drawn_in_finite_numbers(camera: dict[str, object]) -> None:
    values = {"field_of_view": np.radians(30.0), "columns": 360, "rows": 600} | camera
    scene: Scene = unchecked(
        SCENE,
        {
            "camera": Camera.model_construct(**values),
            "bending": unchecked(SCENE.bending, {"angles": (0.0,)}),
        },
    )
    text = sensor_svg(scene, dark=True)
    assert len(panels(text)) == 2
    assert "nan" not in text
    assert ("60 mm below" in text) == ("look_at" in camera)


def test_faces_rougher_than_others_are_dotted_lines_where_they_are() -> None:
    scene = scene_of_case("rough left and lower, smooth tip")
    drawn = [
        [e.attrib["d"] for e in panel.iter(f"{SVG}path") if e.attrib["class"] == "rough"]
        for panel in panels(sensor_svg(scene))
    ]
    # From outside left and right are seen as lines, in the section the lower face.
    assert [len(lines) for lines in drawn] == [2, 1]
    for line in (*drawn[0], *drawn[1]):
        (x0, y0), (x1, y1) = np.array(re.findall(r"-?[\d.]+", line), dtype=float).reshape(-1, 2)
        assert x0 == x1
        assert abs(y1 - y0) == pytest.approx(24.0, abs=2e-3)
    assert 'class="rough"' not in sensor_svg(SCENE)


def test_a_window_lies_on_the_cameras_side_of_the_pad() -> None:
    def boxes(kind: str) -> list[list[float]]:
        section = panels(sensor_svg(scene_of_case("window")))[1]
        return [
            [float(e.attrib[name]) for name in ("x", "y", "width", "height")]
            for e in section.iter(f"{SVG}rect")
            if e.attrib.get("class") == kind
        ]

    ((x, y, thick, high),), ((left, top, whole, height),) = boxes("pad"), boxes("window")
    # The pad is drawn over it: 4.5 mm on the right of 3 mm.
    assert (thick, whole, x - left) == pytest.approx((4.5, 7.5, 3.0), abs=2e-3)
    assert (y, high) == pytest.approx((top, height), abs=2e-3)
    assert 'class="window"' not in sensor_svg(SCENE)


def test_painted_faces_are_lines_of_their_color_where_they_are() -> None:
    outside, section = panels(sensor_svg(scene_of_case("white, mirror and black walls")))
    line = {
        e.attrib["class"]: np.array(re.findall(r"-?[\d.]+", e.attrib["d"]), dtype=float)
        for e in outside.iter(f"{SVG}path")
    }
    # From corner to corner of 20 x 24 mm: along the tip, down the right, along the base.
    (x0, y0, x1, y1), right, base = line["white"], line["mirror"], line["black"]
    np.testing.assert_allclose([x1 - x0, y1 - y0], [20.0, 0.0], atol=2e-3)
    np.testing.assert_allclose(right, [x1, y0 + 24.0, x1, y0], atol=2e-3)
    np.testing.assert_allclose(base, [x0, y0 + 24.0, x1, y0 + 24.0], atol=2e-3)
    # Seen from the side, left and right lie behind one another.
    found = [e.attrib["class"] for e in section.iter(f"{SVG}path")]
    assert found.count("painted") == 2
    assert "mirror" not in found


@pytest.mark.parametrize("case", ["dome", "arch along x rough 0.1"])
def test_the_view_of_a_curved_skin_ends_on_it(case: str) -> None:
    scene, radius = scene_of_case(case), {"dome": 30.0}.get(case, 20.0)
    narrow = unchecked(scene.camera, {"field_of_view": np.radians(40.0)})
    scene = unchecked(scene, {"camera": narrow})
    section = panels(sensor_svg(scene))[1]
    (path,) = [e for e in section.iter(f"{SVG}path") if e.attrib["class"] == "view"]
    corner = np.array(re.findall(r"-?[\d.]+", path.attrib["d"]), dtype=float).reshape(-1, 2)
    (skin,) = [e for e in section.iter(f"{SVG}path") if e.attrib["class"] == "skin"]
    line = np.array(re.findall(r"-?[\d.]+", skin.attrib["d"]), dtype=float).reshape(-1, 2)
    # The crown of the section is its rightmost point, on the level of the pad's middle.
    crown = line[line[:, 0].argmax()]
    on_skin, middle = corner[2:-1], crown - [radius, 0.0]
    away = np.hypot(*(on_skin - middle).T) - radius
    assert np.abs(away).max() < 0.02
    # The half angle of the longer side, 20 deg in air, by Snell's law from a camera 20 mm below.
    sine = np.sin(np.radians(20.0)) / scene.pad.index
    height = on_skin[:, 0].min() - (crown[0] - scene.pad.thickness)
    reach = 20.0 * np.tan(np.radians(20.0)) + height * sine / np.sqrt(1 - sine**2)
    level = on_skin[:, 1] - crown[1]
    assert [level.min(), level.max()] == pytest.approx([-reach, reach], abs=0.03)
