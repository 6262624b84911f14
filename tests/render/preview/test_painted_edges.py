"""Painted edges in the preview: which light comes back from them, and what it is let in by."""

from __future__ import annotations

import numpy as np
import pytest

from render.preview import Preview
from render.preview.beams import BEAM_MARK, Beams, beam_turns
from render.preview.light_paths import walls_met, walls_reflect
from render.preview.lights import with_images
from render.preview.radiosity import solve_radiosity
from render.preview.shading_points import shading_points
from render.scene import EDGES, FACES, Scene, unchecked
from tests.oracles.pads import CASES, scene_of_case

LEFT, TIP, RIGHT, BASE, LOWER = range(len(FACES))
MIXED = "white, mirror and black walls"


def case(name: str, **reflectance: float) -> Scene:
    """Return a case with other reflectances of its white and metal faces."""
    scene = scene_of_case(name)
    faces = tuple(
        unchecked(entry, {kind: reflectance[kind] for kind in entry.kinds if kind in reflectance})
        for entry in scene.faces or ()
    )
    return unchecked(scene, {"faces": faces})


def light(scene: Scene) -> np.ndarray:
    """Return what all lamps give to every facet and site."""
    with Preview(scene) as preview:
        facets, sites = preview.transport(np.array([1.2]), np.zeros(1))
    return np.concatenate([part.sum(axis=0).ravel() for part in (facets, sites)])


@pytest.mark.parametrize(
    ("turns", "met"),
    [
        ((0, 0), {}),
        ((1, 0), {RIGHT: 1}),
        ((-1, 0), {LEFT: 1}),
        ((2, 1), {RIGHT: 1, LEFT: 1, TIP: 1}),
        ((-3, -2), {LEFT: 2, RIGHT: 1, BASE: 1, TIP: 1}),
    ],
)
def test_light_of_an_image_meets_facing_edges_in_turn(
    turns: tuple[int, int], met: dict[int, int]
) -> None:
    assert walls_met(turns) == met


def test_an_image_leaves_what_its_edges_reflect_each_time() -> None:
    scene, along = scene_of_case("mirror walls"), np.array([[0.6, -0.48, 0.64]])
    # Left and tip are open: smooth silicone is clear at 0.6, total beyond the critical angle.
    r = ((1.41 - 1.0) / (1.41 + 1.0)) ** 2
    straight = np.array([[1.0, 0.0, 0.0]])
    assert walls_reflect(scene, (2, 0), straight)[0] == pytest.approx(0.9 * r)
    assert walls_reflect(scene, (0, -1), along)[0] == pytest.approx(0.9)
    assert walls_reflect(scene, (0, 1), along)[0] == 1.0
    assert walls_reflect(scene, (3, 0), straight)[0] == pytest.approx(0.9**2 * r)


def test_no_image_lies_beyond_black_or_white_edges() -> None:
    scene = scene_of_case(MIXED)
    # White at the tip and black at the base: only left and right take turns.
    assert {across for across, along in beam_turns(scene, LEFT)} == {1, 2}
    assert all(along == 0 for _, along in beam_turns(scene, LEFT))


def test_lamps_are_seen_through_open_faces_alone() -> None:
    scene = scene_of_case("beside a corner")
    entry = scene_of_case("black walls").faces
    assert entry is not None
    tip = unchecked(scene, {"faces": (unchecked(entry[0], {"on": ("tip",)}),)})
    faces = [
        set((Beams(one).position[0, :, 3].astype(int) % BEAM_MARK).tolist()) for one in (scene, tip)
    ]
    assert faces == [{LEFT, TIP}, {LEFT}]


def test_white_edges_have_patches_that_cover_them() -> None:
    points = shading_points(scene_of_case("white walls"))
    size = points.size[points.first_edge :].prod(axis=1)
    assert {EDGES[number] for number in points.edge} == {"right", "base"}
    assert size[points.edge == RIGHT].sum() == pytest.approx(24.0 * 4.5)
    assert size[points.edge == BASE].sum() == pytest.approx(20.0 * 4.5)
    place, normal = points.position[points.first_edge :], points.normal[points.first_edge :]
    np.testing.assert_array_equal(place[points.edge == RIGHT, 0], 10.0)
    np.testing.assert_array_equal(place[points.edge == BASE, 1], -12.0)
    assert (normal[points.edge == RIGHT] == [-1.0, 0.0, 0.0]).all()
    assert (normal[points.edge == BASE] == [0.0, 1.0, 0.0]).all()
    rim = shading_points(scene_of_case("white base beside a rim rough 0.1"))
    assert list(dict.fromkeys(rim.edge.tolist())) == [LEFT, TIP, RIGHT, BASE]
    for name in ("black walls", "mirror walls", "smooth"):
        assert shading_points(scene_of_case(name)).edge.size == 0


def test_a_white_edge_sends_back_in_proportion_to_its_albedo() -> None:
    def added(albedo: float) -> np.ndarray:
        scene = case("white walls", white=albedo)
        points = shading_points(scene)
        lit = np.zeros((1, len(points.position)))
        lit[:, points.first_edge :] = 1.0
        return solve_radiosity(scene, points, 0.0, 0.0).added(lit)[0]

    # Coating and walls light each other, so it is a little more than in proportion.
    twice = added(0.2) / added(0.1)
    assert (twice > 2.0).all()
    assert (twice < 2.2).all()


@pytest.mark.slow
def test_more_comes_back_from_brighter_edges_and_nothing_from_black_ones() -> None:
    black, clear = light(scene_of_case("black walls")), light(scene_of_case("smooth"))
    assert (black <= clear * (1 + 1e-6)).all()
    assert black.sum() < 0.97 * clear.sum()
    for kind, name in (("white", "white walls"), ("mirror", "mirror walls")):
        dark, dim, bright = (light(case(name, **{kind: value})) for value in (1e-9, 0.4, 0.9))
        np.testing.assert_allclose(dark, black, rtol=1e-5)
        assert (dark < dim).all()
        assert (dim < bright).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CASES if "walls" in name])
def test_every_painted_pad_is_drawn_in_finite_numbers(name: str) -> None:
    scene = scene_of_case(name)
    with Preview(scene) as preview:
        shape = (scene.lamp_count, 3)
        picture = preview.picture(np.full(shape[0], 1.2), np.ones(shape), 0.0, 20, 24)
    assert np.isfinite(picture).all()
    assert picture.any()


def test_the_glow_has_images_in_a_base_that_is_clear_or_metal() -> None:
    glows = np.zeros((1, 2, 4))
    glows[0, :, :2] = [[-10.0, -11.0], [-10.0, 8.0]]
    # Metal sends back more than what is clear, of which lights nearby alone have an image.
    for name, images in (
        ("mirror base beside a rim rough 0.1", 2),
        ("rim rough 0.1", 1),
        ("white base beside a rim rough 0.1", 0),
    ):
        scene = scene_of_case(name)
        listed = with_images(scene, glows)[0]
        assert (listed[2:, 3] > 0).sum() == images
