"""The camera's pixels, and which of them show which facet through the refracting face."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

import render.geometry.visibility
from render.arrays import Array
from render.geometry import bend_points, camera_origin, camera_rays, facet_masks, facets
from render.scene import Scene, load_scene, unchecked

SCENE = load_scene("finger20")
BENDS = np.radians([0.0, 45.0, 90.0])


def with_indenter(**values: float) -> Scene:
    return unchecked(SCENE, {"indenter": unchecked(SCENE.indenter, values)})


def test_rays_span_the_vertical_field_of_view_with_square_pixels() -> None:
    origin, top = camera_rays(SCENE, 5, 9, offset=(0.5, 0.0))
    np.testing.assert_allclose(origin, [0.0, 3.0, -10.0])
    assert top.shape == (9, 5, 3)
    assert np.arctan2(top[0, 2, 1], top[0, 2, 2]) == pytest.approx(SCENE.camera.field_of_view / 2)
    slopes = top[..., :2] / top[..., 2:]
    np.testing.assert_allclose(slopes[0, 0, 0] - slopes[0, 1, 0], slopes[0, 0, 1] - slopes[1, 0, 1])


def test_columns_run_towards_minus_x_and_rows_towards_the_base() -> None:
    _, directions = camera_rays(SCENE, 8, 8)
    assert directions[0, 0, 0] > 0 > directions[0, -1, 0]
    assert directions[0, 0, 1] > 0 > directions[-1, 0, 1]
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1.0)


@pytest.mark.usefixtures("variant_kept")
def test_rays_are_those_of_mitsubas_perspective_sensor() -> None:
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    origin, expected = camera_rays(SCENE, 24, 40, offset=(0.25, 0.75))
    pose = mi.ScalarTransform4f().look_at(
        origin=list(origin), target=list(origin + [0, 0, 1]), up=[0, 1, 0]
    )
    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": np.degrees(SCENE.camera.field_of_view),
            "fov_axis": "y",
            "to_world": pose,
            "film": {"type": "hdrfilm", "width": 24, "height": 40},
        }
    )
    for column, row in [(0, 0), (23, 5), (12, 39)]:
        where = [(column + 0.25) / 24, (row + 0.75) / 40]
        ray, _ = sensor.sample_ray(0.0, 0.5, where, [0.5, 0.5])
        np.testing.assert_allclose(np.array(ray.d), expected[row, column], atol=1e-5)


def fermat_pixel(target: Array, bend: float, columns: int, rows: int) -> tuple[int, int]:
    """Find the pixel of a point inside the pad by Fermat's principle alone."""
    origin = camera_origin(SCENE)

    def entry(place: Array) -> Array:
        return bend_points(SCENE, np.array([place[0], place[1], 0.0]), bend)

    def optical_length(place: Array) -> float:
        point = entry(place)
        inside = SCENE.pad.index * np.linalg.norm(target - point)
        return float(np.linalg.norm(point - origin) + inside)

    best = minimize(optical_length, target[:2], method="Nelder-Mead", options={"xatol": 1e-5})
    x, y, z = entry(best.x) - origin
    half_height = np.tan(SCENE.camera.field_of_view / 2)
    row = 0.5 * (1 - y / z / half_height) * rows
    column = 0.5 * (1 - x / z / (half_height * columns / rows)) * columns
    return int(column), int(row)


@pytest.mark.parametrize("bend", BENDS)
def test_the_centroid_of_a_facet_appears_in_its_own_mask(bend: float) -> None:
    masks = facet_masks(SCENE, bend, columns=480, rows=800)
    centroid = facets(SCENE, bend).centroid
    for site in (0, 7, 14):
        for facet in range(0, SCENE.indenter.faces, 3):
            column, row = fermat_pixel(centroid[site, facet], bend, 480, 800)
            assert row * 480 + column in masks.of(site, facet)


@pytest.mark.parametrize("bend", BENDS)
def test_the_default_camera_sees_every_facet_and_every_background_spot(bend: float) -> None:
    masks = facet_masks(SCENE, bend)
    assert masks.seen.all()
    assert masks.counts[:, -1].min() >= 40
    assert masks.offset[-1] == len(masks.pixel)
    assert masks.seen.shape == (15, 10)


def test_no_pixel_shows_two_facets() -> None:
    masks = facet_masks(SCENE, 0.5)
    pixels = np.concatenate([masks.of(s, k) for s in range(15) for k in range(10)])
    assert len(np.unique(pixels)) == len(pixels)


def test_masks_of_an_almost_flat_pad_are_those_of_the_flat_one() -> None:
    flat, almost = facet_masks(SCENE, 0.0), facet_masks(SCENE, 1e-6)
    np.testing.assert_array_equal(flat.counts.sum(axis=0) > 0, almost.counts.sum(axis=0) > 0)
    assert np.abs(flat.counts - almost.counts).max() <= 1
    assert len(np.intersect1d(flat.pixel, almost.pixel)) > 0.995 * len(np.unique(flat.pixel))


def test_masks_are_mirror_images_of_each_other() -> None:
    counts = facet_masks(SCENE, 0.7).counts[:, :-1].reshape(5, 3, 10)
    mirrored = counts[:, ::-1][..., (10 - np.arange(10)) % 10]
    np.testing.assert_array_equal(counts, mirrored)


def test_pixels_lie_inside_the_pyramid_and_a_wider_margin_only_removes_some() -> None:
    loose, tight = facet_masks(SCENE, 0.0, margin=0.0), facet_masks(SCENE, 0.0, margin=0.4)
    for facet in range(10):
        assert set(tight.of(4, facet)) < set(loose.of(4, facet))


def test_a_steep_facet_that_faces_away_is_not_seen() -> None:
    masks = facet_masks(with_indenter(slope=np.radians(75.0), radius=0.5), 0.0)
    # Site 0 is at the base, left: its facets that look left and to the base face away.
    assert not masks.seen[0, 6]
    assert masks.seen[0, 1]


def test_a_pyramid_hides_what_lies_behind_it() -> None:
    # A low camera sees row 0 past pyramids that are 3 mm deep, 3 mm nearer to it.
    camera = unchecked(SCENE.camera, {"distance": 2.0, "y": 9.0, "field_of_view": 2.9})
    crowd = unchecked(with_indenter(slope=np.radians(73.0), radius=0.98), {"camera": camera})
    row = unchecked(crowd.sites, {"rows": 1, "centre_y": -3.0})
    alone = unchecked(crowd, {"sites": row})
    crowded, free = (facet_masks(scene, 0.0, columns=600, rows=600) for scene in (crowd, alone))
    assert 0 < crowded.counts[:3, :10].sum() < free.counts[:, :10].sum()
    for facet in range(10):
        assert set(crowded.of(1, facet)) <= set(free.of(1, facet))


def test_facets_too_small_for_the_image_are_masked_not_guessed() -> None:
    masks = facet_masks(SCENE, 0.0, columns=24, rows=40)
    assert not masks.seen.any()
    assert masks.counts.sum() == len(masks.pixel)


def test_sites_beyond_the_horizon_of_a_strong_bend_are_not_seen() -> None:
    # The rows reach from y = -13 to 13 mm; the camera at y = 3 mm looks at the middle of them.
    sites = unchecked(SCENE.sites, {"rows": 3, "spacing": 13.0, "centre_y": 0.0})
    scene = unchecked(SCENE, {"sites": unchecked(sites, {"columns": 1})})
    assert facet_masks(scene, 0.0).counts[1].min() > 0
    bent = facet_masks(scene, np.pi)
    assert not bent.counts[0].any()
    assert bent.seen[1].all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["finger20", "digit", "gelsight-flat"])
@pytest.mark.parametrize("size", [(640, 480), (333, 501)])
def test_blocks_of_pixels_of_a_large_camera_leave_nothing_out(
    name: str, size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = load_scene(name)
    for bend in scene.bending.angles:
        every = facet_masks(scene, bend, columns=size[0], rows=size[1])
        with monkeypatch.context() as patch:
            patch.setattr(render.geometry.visibility, "MANY_PIXELS", 0)
            blocks = facet_masks(scene, bend, columns=size[0], rows=size[1])
        assert every.pixel.size > 0
        np.testing.assert_array_equal(blocks.pixel, every.pixel)
        np.testing.assert_array_equal(blocks.offset, every.offset)
