"""The camera's mixing of facets."""

import numpy as np
import pytest

from render.preview.facet_blur import RINGS, facet_blur, facet_blurs, ring_count
from render.scene import Scene, load_scene, unchecked
from tests.oracles.random_scenes import random_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


def with_roughness(scene: Scene, roughness: float) -> Scene:
    pad = unchecked(scene.pad, {"roughness": roughness})
    return unchecked(scene, {"pad": pad})


def scale(scene: Scene) -> float:
    return float(scene.coating.albedo / (np.pi * scene.pad.index**2))


@pytest.mark.parametrize("bend", [0.0, np.pi / 2])
def test_a_smooth_face_shows_every_facet_alone(scene: Scene, bend: float) -> None:
    weights = facet_blur(with_roughness(scene, 0.0), bend) / scale(scene)
    rows, columns = np.arange(scene.indenter.faces + 1), [*range(scene.indenter.faces), -1]
    alone = weights[:, rows, columns]
    assert (alone > 0.9).all()
    assert (alone < 1.0).all()
    weights[:, rows, columns] = 0.0
    np.testing.assert_array_equal(weights, 0.0)


def test_a_rough_face_mixes_neighbors_but_loses_no_light(scene: Scene) -> None:
    smooth = facet_blur(with_roughness(scene, 0.0), 0.0)
    rough = facet_blur(scene, 0.0)
    np.testing.assert_allclose(rough.sum(axis=-1), smooth.sum(axis=-1), rtol=0.01)
    facets = np.arange(scene.indenter.faces)
    diagonal = rough[:, facets, facets]
    neighbor = rough[:, facets, (facets + 1) % scene.indenter.faces]
    assert (diagonal < 0.9 * smooth[:, facets, facets]).all()
    assert (neighbor > 0).all()
    assert (neighbor < diagonal).all()


def test_the_untouched_site_is_seen_as_itself(scene: Scene) -> None:
    last = facet_blur(scene, 0.0)[:, -1]
    np.testing.assert_array_equal(last[:, :-1], 0.0)
    assert (last[:, -1] > 0).all()


def test_a_line_that_passes_the_pyramid_meets_the_foot_of_the_facet_that_it_is_before(
    scene: Scene,
) -> None:
    faces = scene.indenter.faces
    rough = facet_blur(scene, 0.0)[:, :faces, faces : 2 * faces]
    turned = np.stack([np.roll(rough[:, facet], -facet, axis=-1) for facet in range(faces)])
    before = turned.mean(axis=(0, 1)) / turned.mean(axis=(0, 1)).sum()
    assert before[[-1, 0, 1]].sum() > 0.9
    assert before[0] == before.max()


def test_rings_around_the_pyramid_have_the_light_of_all_lines_that_pass_it() -> None:
    scene = random_scene(20)
    faces, rings = scene.indenter.faces, ring_count(scene)
    assert rings == len(RINGS) - 1
    (whole,) = facet_blurs(scene, 0.0, rings)
    foot = facet_blur(scene, 0.0)
    np.testing.assert_allclose(whole.sum(axis=-1), foot.sum(axis=-1), rtol=1e-12)
    np.testing.assert_array_equal(whole[..., :faces], foot[..., :faces])
    np.testing.assert_array_equal(whole[:, -1, :-1], 0.0)
    shares = whole[:, :faces] / whole[:, :faces].sum(axis=-1, keepdims=True)
    before = shares[..., faces:-1].reshape(*shares.shape[:2], rings, faces).sum(axis=-1)
    assert (before.mean(axis=(0, 1)) > 0.02).all()
    assert shares[..., -1].mean() < 0.01


@pytest.mark.parametrize("name", ["finger20", "finger24", "digit", "digit-dome", "gelsight-mini"])
def test_pads_that_blur_little_have_one_ring(name: str) -> None:
    assert ring_count(load_scene(name)) == 1


def test_a_thick_pad_blurs_farther_than_the_pyramid_shades() -> None:
    """Of the light of a facet's pixels most comes from the coating that no pyramid reaches."""
    scene = random_scene(20)
    faces = scene.indenter.faces
    weights = facet_blur(scene, 0.0)[:, :faces]
    shares = weights / weights.sum(axis=-1, keepdims=True)
    facets, feet, spot = np.split(shares, [faces, 2 * faces], axis=-1)
    assert facets.sum(axis=-1).mean() < 0.3
    assert spot.mean() > 0.3
    # All around: what is before the facet itself is little of it.
    assert feet[:, range(faces), range(faces)].mean() < 0.5 * feet.sum(axis=-1).mean()
