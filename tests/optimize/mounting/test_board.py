"""Other programs read the board's drawing: centers, outlines, numbers and colors, each in mm."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np
import pytest
import trimesh

from optimize.design import Array, Design, baseline_design
from optimize.mounting import MountedFiber, Mounting, board_dxf, board_svg, mount
from optimize.placement import searched_scene
from render.scene import load_scene, scene_text

BOARD = """
[[search.places]]
corners = { value = [[-8.0, -8.0], [8.0, -8.0], [8.0, 8.5], [-8.0, 8.5]], unit="mm", source="x" }
heights = { value = [-3.0], unit = "mm", source = "test" }
pitch = { value = 4.0, unit = "mm", source = "test" }
[[search.places]]
positions = { value = [[-12.0, 3.0, -1.0]], unit = "mm", source = "test" }
directions = { value = [[1.0, 0.0, 1.0]], source = "test" }
"""


@pytest.fixture(scope="module")
def mounting(tmp_path_factory: pytest.TempPathFactory) -> Mounting:
    """Return a design of one lamp on an edge, two on a board and one that shines up aslant."""
    path = tmp_path_factory.mktemp("board") / "mine.toml"
    path.write_text(scene_text("digit") + BOARD)
    scene = searched_scene(load_scene(path), lamps=4)
    colors = np.full(scene.lamp_count, -1)
    colors[[0, 4, 9, scene.lamp_count - 1]] = 0, 1, 2, 1
    return mount(scene, Design.of_colors(np.full(len(colors), np.pi / 2), colors))


def lamps(mounting: Mounting) -> list[MountedFiber]:
    """Return the lamps that are lit; two of the sensor's own stay off."""
    return [fiber for fiber in mounting.fibers if fiber.power]


def entities(text: str) -> Iterator[tuple[str, dict[int, str]]]:
    """Yield kind and group codes of a DXF file's entities, by the format's own rule of pairs."""
    lines = text.splitlines()
    assert len(lines) % 2 == 0
    pairs = [(int(code), value) for code, value in zip(lines[::2], lines[1::2], strict=True)]
    start = pairs.index((2, "ENTITIES"))
    found: dict[int, str] = {}
    kind = ""
    for code, value in pairs[start + 1 :]:
        if code == 0:
            if kind and kind != "ENDSEC":
                yield kind, found
            kind, found = value, {}
        else:
            found[code] = value


def places(mounting: Mounting) -> Array:
    return np.array([(fiber.x_mm, fiber.y_mm) for fiber in lamps(mounting)])


def test_centers_numbers_and_colors_are_those_of_the_sheet(mounting: Mounting) -> None:
    read = list(entities(board_dxf(mounting)))
    centers = [(float(e[10]), float(e[20])) for kind, e in read if kind == "POINT"]
    assert np.allclose(centers, places(mounting), atol=1e-3)
    texts = {
        layer: [e[1] for kind, e in read if kind == "TEXT" and e[8] == layer]
        for layer in ("NUMBERS", "COLORS")
    }
    assert texts["NUMBERS"] == [str(fiber.fiber) for fiber in lamps(mounting)]
    assert texts["COLORS"] == [fiber.color for fiber in lamps(mounting)]
    assert {e[8] for _, e in read} == {"PAD", "BODIES", "CENTERS", "BEAMS", "NUMBERS", "COLORS"}


def boxes(mounting: Mounting) -> Array:
    """Return bounds ``(entity, 2, 2)`` of outlines and lines, as another program reads them."""
    drawing = trimesh.load_path(io.StringIO(board_dxf(mounting)), file_type="dxf")
    assert drawing.units == "millimeters"
    kinds = [type(entity).__name__ for entity in drawing.entities]
    assert kinds.count("Text") == 2 * len(lamps(mounting))
    return np.array([entity.bounds(drawing.vertices) for entity, kind in
                     zip(drawing.entities, kinds, strict=True) if kind != "Text"])  # fmt: skip


def test_another_program_reads_outlines_and_units(mounting: Mounting) -> None:
    found = boxes(mounting)
    # The pad; along the tip a line of 1.3 mm; at 45 deg an ellipse; two circles; two beams.
    aslant = 1.3 / np.sqrt(2.0)
    expected = [
        (18.3, 25.0, (0.0, 0.0)),
        *((1.3, 0.0, place) for place in places(mounting)[:1]),
        *((1.3, 1.3, place) for place in places(mounting)[1:3]),
        (aslant, 1.3, places(mounting)[3]),
        (0.0, 2.0, places(mounting)[0] - [0.0, 1.0]),
        (2.0 / np.sqrt(2.0), 0.0, places(mounting)[3] + [1.0 / np.sqrt(2.0), 0.0]),
    ]
    assert len(found) == len(expected)
    for width, height, middle in expected:
        near = np.abs(np.ptp(found, axis=1) - [width, height]).max(axis=1) < 5e-3
        near &= np.abs(found.mean(axis=1) - middle).max(axis=1) < 1e-2
        assert near.any(), (width, height, middle)


def test_the_picture_has_the_same_in_true_size(mounting: Mounting) -> None:
    root = ET.fromstring(board_svg(mounting))
    name = "{http://www.w3.org/2000/svg}"
    width, height = (float(root.attrib[side].removesuffix("mm")) for side in ("width", "height"))
    assert [float(part) for part in root.attrib["viewBox"].split()] == [0.0, 0.0, width, height]
    groups = {group.attrib["id"]: group for group in root.findall(f"{name}g")}
    assert [text.text for text in groups["NUMBERS"]] == [str(f.fiber) for f in lamps(mounting)]
    circles = [(float(c.attrib["cx"]), float(c.attrib["cy"])) for c in groups["BODIES"]
               if c.tag == f"{name}circle"]  # fmt: skip
    up = [i for i, fiber in enumerate(lamps(mounting)) if fiber.towards_z == 1.0]
    expected = places(mounting)[up] * [1.0, -1.0]
    assert np.allclose(np.ptp(circles, axis=0), np.ptp(expected, axis=0), atol=1e-3)


def test_a_diffuser_has_an_outline_beside_the_pads() -> None:
    scene = load_scene("finger20")
    sizes = np.ptp(boxes(mount(scene, baseline_design(scene))), axis=1)
    for size in ([scene.pad.width, scene.pad.length], (scene.box.high - scene.box.low)[:2]):
        assert (np.abs(sizes - size).max(axis=1) < 1e-3).sum() == 1
