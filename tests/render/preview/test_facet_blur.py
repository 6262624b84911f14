"""The camera's mixing of facets."""

import numpy as np
import pytest

from render.preview.facet_blur import facet_blur
from render.scene import Scene, load_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


def with_roughness(scene: Scene, roughness: float) -> Scene:
    pad = scene.pad.model_copy(update={"roughness": roughness})
    return scene.model_copy(update={"pad": pad})


def scale(scene: Scene) -> float:
    return float(scene.coating.albedo / (np.pi * scene.pad.index**2))


@pytest.mark.parametrize("bend", [0.0, np.pi / 2])
def test_a_smooth_face_shows_every_facet_alone(scene: Scene, bend: float) -> None:
    weights = facet_blur(with_roughness(scene, 0.0), bend) / scale(scene)
    diagonal = np.einsum("sii->si", weights)
    assert (diagonal > 0.9).all()
    assert (diagonal < 1.0).all()
    np.testing.assert_array_equal(weights[:, ~np.eye(weights.shape[1], dtype=bool)], 0.0)


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
