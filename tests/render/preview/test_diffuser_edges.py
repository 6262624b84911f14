"""The previews of pads with a diffuser on some edges: mirrored sensors have mirrored light."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from render.preview import Preview
from render.preview.beams import shines_past_layers
from render.preview.converged.block import bent_block, face_grid
from render.preview.converged.transport import Effort, flies, task_count, transport_at
from render.preview.converged.walks import BASE, END, LEFT, RIGHT, START, TIP
from render.preview.light_paths import wall_images
from render.preview.lights import with_images
from render.preview.shading_points import shading_points
from render.progress import Clock
from render.scene import EDGES, Scene, unchecked
from tests.oracles.pads import content_of_case, listed, row

TURN = {"left": "right", "right": "left", "tip": "base", "base": "tip"}
FACES = 6
EFFORT = Effort(photons=40_000, paths=512, arrivals=100_000)


def scene_on(*edges: str, lit: tuple[str, ...] = (), bend: float = 0.0, **changes: Any) -> Scene:
    """Return a small pad with a diffuser on ``edges`` and a lamp at each of ``lit`` (or those)."""
    content = content_of_case("rim on left rough 0.1")
    del content["fibers"]
    rows = [row(edge, 1, tilt=0.0) for edge in EDGES if edge in (lit or edges)]
    content |= {"rows": _file_form(rows), "baseline": {entry["edge"]: "red" for entry in rows}}
    content["diffuser"]["on"] = list(edges)
    content["sites"]["centre_y"]["value"] = 0.0
    content["bending"]["angles"]["value"] = [bend]
    return Scene.model_validate(content | changes)


def _file_form(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [
        {
            name: {"value": value[0], "unit": value[1], "source": "chosen for this test"}
            if isinstance(value, tuple)
            else value
            for name, value in entry.items()
        }
        for entry in rows
    ]


def drawn(scene: Scene) -> np.ndarray:
    """Return ``(lamp, row, column, facet)`` of the shader's preview at the scene's bend."""
    with Preview(scene) as preview:
        cells, _ = preview.transport(np.array([np.pi / 2]), np.array(scene.bending.angles))
    return cells.reshape(scene.lamp_count, 2, 3, FACES)


def converged(scene: Scene) -> np.ndarray:
    """Return the same of traced light."""
    clock = Clock(task_count(scene, EFFORT), None)
    bend = scene.bending.angles[0]
    cells = transport_at(scene, bend, np.array([np.pi / 2]), EFFORT, clock).cells
    return cells[:, 0, :, :-1].reshape(scene.lamp_count, 2, 3, FACES)


def mirrored_in_x(cells: np.ndarray) -> np.ndarray:
    return np.roll(cells[:, :, ::-1, ::-1], 1, axis=-1)


def mirrored_in_y(cells: np.ndarray) -> np.ndarray:
    # Facet k at the azimuth 60 k deg from the tip comes to 180 - 60 k.
    return cells[:, ::-1][..., (3 - np.arange(FACES)) % FACES]


@pytest.mark.slow
@pytest.mark.parametrize("bend", [0.0, 40.0])
def test_left_and_right_are_mirror_images(bend: float) -> None:
    for lit in (("left",), ("right",)):
        one = drawn(scene_on("left", lit=lit, bend=bend))
        other = drawn(scene_on("right", lit=(TURN[lit[0]],), bend=bend))
        np.testing.assert_allclose(mirrored_in_x(other), one, rtol=2e-4)


@pytest.mark.slow
def test_tip_and_base_are_mirror_images_on_a_flat_pad() -> None:
    def skin(scene: Scene) -> np.ndarray:
        with Preview(scene) as preview:
            return preview.skin(np.array([np.pi / 2]), np.zeros(1))[0, 0, 0]

    for lit, turned in (("tip", "base"), ("base", "tip"), ("left", "left")):
        one, other = skin(scene_on("tip", lit=(lit,))), skin(scene_on("base", lit=(turned,)))
        np.testing.assert_allclose(other[::-1], one, rtol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("lit", ["tip", "base"])
def test_converged_light_through_the_base_is_that_through_the_tip(lit: str) -> None:
    one = converged(scene_on("tip", lit=(lit,)))
    other = mirrored_in_y(converged(scene_on("base", lit=(TURN[lit],))))
    assert other.sum() == pytest.approx(one.sum(), rel=0.05)
    # Not only the same on the whole: the facets' own light.
    assert np.median(np.abs(other / one - 1)) < 0.2
    assert np.corrcoef(other.ravel(), one.ravel())[0, 1] > 0.97


def test_the_block_of_the_walks_ends_where_the_silicone_does() -> None:
    scene = scene_on("left", "base")
    block, grid = bent_block(scene, 0.0, pressed=False), face_grid(scene)
    np.testing.assert_array_equal(block.rims > 0.0, [True, False, False, True])
    assert (block.base[2], block.start[2]) == (-12.0, -14.0)
    assert block.tip[2] == block.end[2] == 12.0
    assert (grid.columns > 0).tolist() == [True, False, False, True]
    assert grid.first[BASE] == grid.columns[LEFT]
    assert {LEFT, TIP, RIGHT, BASE} == set(range(4))
    assert START != END


def test_edges_send_light_back_as_what_lies_on_them() -> None:
    scene = scene_on("left", "base")
    assert {EDGES[number] for number in shading_points(scene).edge} == {"left", "base"}
    # Clear are the tip and the right edge: images in both of them, and in the corner between.
    assert {image.turns for image in wall_images(scene)} == {(0, 1), (1, 0), (1, 1)}
    bending = unchecked(scene, {"bending": unchecked(scene.bending, {"angles": (0.0, 0.5)})})
    assert {image.turns for image in wall_images(bending)} == {(0, 1), (1, 0)}
    assert wall_images(scene_on(*EDGES)) == []


def test_a_glow_is_seen_in_every_clear_wall_with_the_number_of_its_light() -> None:
    scene, glows = scene_on("left"), np.zeros((1, 2, 4))
    glows[0, :, :3] = [[-10.0, -11.0, 2.0], [-10.0, 8.0, 1.0]]
    listed_ = with_images(scene, glows)[0]
    images = listed_[2:][listed_[2:, 3] > 0]
    marks = images[:, 3].astype(int)
    assert (marks & 15 == 0).all()
    for turns in {image.turns for image in wall_images(scene)}:
        mine = ((marks >> 4) & 15) - 8 == turns[0]
        mine &= ((marks >> 8) & 15) - 8 == turns[1]
        assert sorted((marks[mine] // 4096 - 1).tolist()) == [0, 1]
        # x = -10 beyond the right edge at 10 is 30, y beyond the tip at 12 is 24 - y.
        place = images[mine][np.argsort(marks[mine])]
        if turns == (1, 0):
            np.testing.assert_allclose(place[:, :3], [[30.0, -11.0, 2.0], [30.0, 8.0, 1.0]])
        if turns == (0, 1):
            np.testing.assert_allclose(place[:, :3], [[-10.0, 35.0, 2.0], [-10.0, 16.0, 1.0]])


def test_a_lamp_that_shines_beside_the_layer_too_has_beams() -> None:
    corner = listed(-14.0, 13.5, 2.0, 1.0, -0.4, 0.0)
    content = {"lamps": _file_form([corner | {"direction": corner["direction"] + (None,)}])}
    content["lamps"][0]["direction"].pop("unit")
    content["baseline"] = {"left": "red", "lamps": ["red"]}  # type: ignore[assignment]
    scene = scene_on("left", **content)
    assert shines_past_layers(scene).tolist() == [False, True]
    assert flies(scene).tolist() == [False, True]
