"""The preview: invariants of transport and pictures, and its answers to bad input."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import render.preview.lights
from render.errors import DesignError, GraphicsError
from render.geometry import (
    camera_rays,
    counted_sites,
    distance_to_coating,
    facet_masks,
    facet_normals,
    fiber_edges,
    flat_sites,
    mirror_twins,
    refract_into_pad,
    unbend_points,
)
from render.preview import Preview
from render.scene import Camera, Scene, load_scene, unchecked
from tests.oracles.pads import scene_of_case

BENDS = np.array([0.0, 1e-6, np.pi / 4, np.pi])
PHI = np.array([0.0, 0.6, np.pi - 0.6, np.pi])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache of rough responses: the invariants hold for any of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(render.preview.lights, "RAYS", 20_000)
        yield tmp_path_factory.mktemp("slab")


@pytest.fixture(scope="module")
def preview(scene: Scene, cache: Path) -> Iterator[Preview]:
    with Preview(scene, cache=cache) as drawn:
        yield drawn


@pytest.fixture(scope="module")
def transport(preview: Preview) -> tuple[np.ndarray, np.ndarray]:
    return preview.transport(PHI, BENDS)


def baseline(scene: Scene) -> np.ndarray:
    color = {"left": (1, 0, 0), "tip": (0, 0, 1), "right": (0, 1, 0)}
    return np.array([color[edge] for edge in fiber_edges(scene)], dtype=float)


def test_every_cell_is_finite_and_lit(transport: tuple[np.ndarray, np.ndarray]) -> None:
    facets, background = transport
    assert facets.shape == (20, 4, 4, 15, 10)
    assert background.shape == (20, 4, 4, 15)
    for values in transport:
        assert np.isfinite(values).all()
        assert (values > 0).all()


def test_a_bend_of_a_millionth_of_a_degree_is_no_bend(
    transport: tuple[np.ndarray, np.ndarray],
) -> None:
    for values in transport:
        np.testing.assert_allclose(values[:, :, 1], values[:, :, 0], rtol=1e-3)


def test_the_mirrored_sensor_sees_mirrored_light(
    scene: Scene, transport: tuple[np.ndarray, np.ndarray]
) -> None:
    def image(points: np.ndarray) -> np.ndarray:
        mirrored = points * [-1, 1, 1]
        return np.linalg.norm(points[:, None] - mirrored, axis=-1).argmin(axis=0)

    site, facet = image(flat_sites(scene)), image(facet_normals(scene))
    tip = np.array([edge == "tip" for edge in fiber_edges(scene)])
    values = transport[0][:, :, :, site][..., facet]
    # A side's direction keeps its angle from the tip; at the tip phi becomes pi - phi.
    values = np.where(tip[:, None, None, None, None], values[:, ::-1], values)
    np.testing.assert_allclose(values[mirror_twins(scene).twin], transport[0], rtol=1e-3)


def test_between_its_nodes_transport_is_what_the_shader_draws(preview: Preview) -> None:
    phi = np.random.default_rng(1).uniform(0, np.pi, (20, 2))
    for bend in (0.0, 0.8):
        drawn = preview.draw(phi, bend)
        facets, background = preview.transport(phi, np.array([bend]))
        np.testing.assert_allclose(facets[:, :, 0], drawn[..., :-1], rtol=1e-3)
        np.testing.assert_allclose(background[:, :, 0], drawn[..., -1], rtol=1e-3)


def test_light_falls_from_where_the_fiber_is(
    scene: Scene, transport: tuple[np.ndarray, np.ndarray]
) -> None:
    # At bend 0 the facet that faces a lit edge outshines the one that turns its back on it.
    facets = transport[0][:, 1, 0].mean(axis=1)
    normal = facet_normals(scene)
    right, left = normal[:, 0].argmax(), normal[:, 0].argmin()
    assert (facets[2:8, left] > 1.5 * facets[2:8, right]).all()
    assert (facets[12:18, right] > 1.5 * facets[12:18, left]).all()


def test_pictures_superpose(preview: Preview, scene: Scene) -> None:
    phi, power = np.linspace(0.2, 2.9, 20), baseline(scene)
    parts = [
        preview.picture(phi, power * [[float(c == k) for c in range(3)]], 0.5, 40, 30)
        for k in range(3)
    ]
    whole = preview.picture(phi, power, 0.5, 40, 30)
    np.testing.assert_allclose(sum(parts), whole, rtol=1e-4, atol=1e-6 * whole.max())
    half = preview.picture(phi, 0.5 * power, 0.5, 40, 30)
    np.testing.assert_allclose(2 * half, whole, rtol=1e-4, atol=1e-6 * whole.max())


@pytest.mark.parametrize("bend", [0.0, np.pi / 4])
def test_a_picture_shows_the_transport_of_the_untouched_pad(
    preview: Preview, scene: Scene, bend: float
) -> None:
    # Both come from one shading function; the picture merges lights and is sharp.
    power = baseline(scene)
    phi = np.full(20, np.pi / 2)
    image = preview.picture(phi, power, bend, 200, 200, indented=False)
    _, background = preview.transport(np.array([np.pi / 2]), np.array([bend]))
    expected = np.einsum("fs,fc->sc", background[:, 0, 0], power)
    center = scene.sites.count // 2
    column, row = _pixel(scene, flat_sites(scene)[center], 200)
    if bend == 0.0:
        np.testing.assert_allclose(image[row, column], expected[center], rtol=0.05)
    assert image[row, column].sum() == pytest.approx(expected[center].sum(), rel=0.1)


def _pixel(scene: Scene, point: np.ndarray, size: int) -> tuple[int, int]:
    """Return the column and row that show a point right above the camera."""
    assert point[0] == 0.0
    assert point[1] == scene.camera.y
    return size // 2, size // 2


def test_left_is_left_and_the_tip_is_up(preview: Preview, scene: Scene) -> None:
    image = preview.picture(np.full(20, np.pi / 2), baseline(scene), 0.0, 120, 120)
    seen = image.sum(axis=-1) > 0
    rows, columns = np.nonzero(seen)
    left = image[:, : 1 + (columns.min() + columns.max()) // 2]
    assert left[..., 0].sum() > 1.5 * left[..., 1].sum()
    top = image[rows.min() + 2]
    assert top[..., 2].sum() > top[..., 0].sum()
    # The camera stands nearer to the tip: less of the pad lies above it.
    assert seen[:60].sum() < seen[60:].sum()


def test_pyramids_show_in_the_indented_picture_only(preview: Preview, scene: Scene) -> None:
    args = (np.full(20, np.pi / 2), baseline(scene), 0.0, 200, 200)
    pressed, untouched = preview.picture(*args), preview.picture(*args, indented=False)
    # Shadows fade out around them; a tenth is what one sees at once.
    changed = (np.abs(pressed - untouched) > 0.1 * untouched).any(axis=-1)
    assert 0.001 < changed.mean() < 0.05
    near = (pressed != untouched).any(axis=-1)
    assert near.mean() < 0.2


def test_a_pyramid_throws_a_shadow_away_from_the_light(scene: Scene, cache: Path) -> None:
    # Steep and alone on the pad, lit from the left: what lies behind it is darker, before it not.
    steep = unchecked(
        scene,
        {
            "indenter": unchecked(scene.indenter, {"slope": np.radians(60.0)}),
            "sites": unchecked(scene.sites, {"columns": 1, "rows": 1}),
        },
    )
    power = baseline(scene) * [1, 0, 0]
    with Preview(steep, cache=cache) as preview:
        pressed, untouched = (
            preview.picture(np.full(20, np.pi / 2), power, 0.0, 200, 200, indented=indented)
            for indented in (True, False)
        )
    column, row = _pixel(steep, flat_sites(steep)[0], 200)
    seen = pressed[row, :, 0] / np.maximum(untouched[row, :, 0], 1e-30)
    half = (untouched[row, :, 0] > 0).sum() / scene.pad.width * scene.indenter.radius
    behind, before = (seen[int(column + side * 1.6 * half)] for side in (1, -1))
    assert behind < 0.9
    assert before == pytest.approx(1.0, abs=0.03)
    far = seen[int(column + 6 * half)]
    assert far == pytest.approx(1.0, abs=0.03)


def test_osmesa_and_egl_agree(scene: Scene, cache: Path, preview: Preview) -> None:
    with Preview(scene, backend="egl", cache=cache) as other:
        mine, its = (p.transport(PHI[:2], np.array([0.7]))[0] for p in (preview, other))
    np.testing.assert_allclose(mine, its, rtol=1e-4)


def test_a_bare_scene_needs_no_diffuser(scene: Scene, tmp_path: Path) -> None:
    bare = unchecked(scene, {"diffuser": None})
    with Preview(bare, cache=tmp_path) as preview:
        facets, _ = preview.transport(np.array([0.3, np.pi / 2]), np.array([0.0, 0.5]))
        assert (facets > 0).all()
        image = preview.picture(np.full(20, 1.0), baseline(bare), 0.5, 40, 30)
        assert np.isfinite(image).all()
    assert not list(tmp_path.iterdir())


def test_turning_a_bare_beam_away_darkens_the_pad(scene: Scene) -> None:
    with Preview(unchecked(scene, {"diffuser": None})) as preview:
        light = preview.transport(np.array([0.0, np.pi / 2, np.pi]), np.zeros(1))[1]
    total = light.sum(axis=(0, 2, 3))
    assert total[1] > 3 * max(total[0], total[2])


@pytest.mark.parametrize(
    ("phi", "bend", "text"),
    [
        (np.array([-0.1]), 0.0, r"phi = -5\.\d+ deg, allowed: 0 to 180 deg"),
        (np.array([np.nan]), 0.0, "phi = nan deg"),
        (np.array([1.0]), 3.5, "bend = 200.*allowed: 0 to 180 deg"),
        (np.ones((7, 1)), 0.0, r"phi has shape \(7, 1\), allowed: one row for each of 20 fibers"),
    ],
)
def test_bad_input_is_named(preview: Preview, phi: np.ndarray, bend: float, text: str) -> None:
    with pytest.raises(DesignError, match=text):
        preview.transport(phi, np.array([bend]))


def test_a_power_of_the_wrong_shape_is_named(preview: Preview) -> None:
    with pytest.raises(DesignError, match=r"power has shape \(20,\)"):
        preview.picture(np.ones(20), np.ones(20), 0.0, 20, 20)


def test_a_closed_preview_says_so(scene: Scene, cache: Path) -> None:
    preview = Preview(scene, cache=cache)
    preview.close()
    preview.close()
    with pytest.raises(GraphicsError, match="closed"):
        preview.draw(np.ones((20, 1)), 0.0)


def test_sites_that_do_not_count_have_no_cells_and_the_others_keep_theirs(
    scene: Scene, cache: Path
) -> None:
    # The middle third of the picture, pixel by pixel.
    angle = 2 * np.arctan(np.tan(scene.camera.field_of_view / 2) / 3)
    size = {"columns": scene.camera.columns // 3, "rows": scene.camera.rows // 3}
    camera = unchecked(scene.camera, {"field_of_view": angle, **size})
    narrow = unchecked(scene, {"camera": camera})
    counted = counted_sites(narrow)
    assert 0 < len(counted) < scene.sites.count
    drawn = []
    for each in (narrow, scene):
        with Preview(each, cache=cache) as preview:
            drawn.append(preview.transport(np.array([np.pi / 2]), np.array([0.0])))
    for few, all_sites in zip(*drawn, strict=True):
        np.testing.assert_allclose(few, all_sites[:, :, :, counted], rtol=1e-5)


def test_a_turned_camera_draws_the_turned_picture(scene: Scene, cache: Path) -> None:
    def drawn(columns: int, rows: int, **pose: object) -> np.ndarray:
        angle = 2 * np.arctan(np.tan(np.radians(45.0)) * rows / 60)
        camera = Camera.model_construct(field_of_view=angle, columns=360, rows=600, **pose)
        moved = unchecked(scene, {"camera": camera})
        with Preview(moved, cache=cache) as preview:
            phi = np.full(scene.lamp_count, np.pi / 2)
            return preview.picture(phi, baseline(scene), 0.0, columns, rows)

    straight = drawn(36, 60, position=(0.0, 3.0, -10.0))
    assert straight.any()
    half = drawn(36, 60, position=(0.0, 3.0, -10.0), up=(0.0, -1.0, 0.0))
    np.testing.assert_allclose(half[::-1, ::-1], straight, rtol=1e-4, atol=1e-9)
    # Up is +x, so that the right of our picture, which is +x, comes to the top.
    quarter = drawn(60, 36, position=(0.0, 3.0, -10.0), up=(1.0, 0.0, 0.0))
    np.testing.assert_allclose(quarter, np.rot90(straight), rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("lens", ["pinhole", "fisheye"])
def test_a_pixel_of_an_askew_camera_shows_what_its_ray_meets(
    scene: Scene, cache: Path, lens: str
) -> None:
    camera = Camera.model_construct(
        position=(4.0, -9.0, -12.0), look_at=(1.0, 2.0, 4.0), lens=lens,
        field_of_view=np.radians(80.0), columns=360, rows=600,
    )  # fmt: skip
    moved = unchecked(scene, {"camera": camera})
    with Preview(moved, cache=cache) as preview:
        phi = np.full(scene.lamp_count, np.pi / 2)
        picture = preview.picture(phi, baseline(scene), 0.7, 90, 150, indented=False)
    rays = refract_into_pad(moved, 0.7, *camera_rays(moved, 90, 150))
    way = distance_to_coating(moved, 0.7, rays)
    met = rays.inside & np.isfinite(way)
    flat = unbend_points(
        moved, rays.entry + np.where(met, way, 0.0)[..., None] * rays.direction, 0.7
    )
    half = np.array([scene.pad.width, scene.pad.length]) / 2
    on_pad = met & (np.abs(flat[..., :2]) < half).all(axis=-1)
    lit = picture.sum(axis=-1)[:, ::-1] > 0
    assert 0.2 < on_pad.mean() < 0.95
    # Only pixels on the border may differ, by rounding.
    assert (lit != on_pad).mean() < 0.02


def test_a_picture_of_a_dome_shows_what_its_cells_say() -> None:
    dome = scene_of_case("dome")
    lamps, camera, masks = dome.lamp_count, dome.camera, facet_masks(dome, 0.0)
    with Preview(dome) as preview:
        cells, untouched = preview.transport(np.array([1.2]), np.zeros(1))
        for indented in (True, False):
            picture = preview.picture(
                np.full(lamps, 1.2), np.ones((lamps, 3)), 0.0, camera.columns, camera.rows, indented
            )[:, ::-1, 0].ravel()  # masks have the camera's left and right
            for site in range(dome.sites.count):
                shown = range(dome.indenter.faces) if indented else [dome.indenter.faces]
                for facet in shown:
                    seen = picture[masks.of(site, facet)].mean()
                    of_all = cells[:, 0, 0, site, facet] if indented else untouched[:, 0, 0, site]
                    assert seen == pytest.approx(of_all.sum(), rel=0.08)
