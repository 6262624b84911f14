"""The slab response and its cache."""

import time
from pathlib import Path

import numpy as np
import pytest

from render.errors import RenderError
from render.preview import SlabResponse, compute_response, fiber_end_of, slab_of
from render.preview.diffuser.basis import MIRROR_ALONG, directional_terms, moments
from render.preview.diffuser.cache import slab_response
from render.preview.diffuser.emission import emit_from_fiber
from render.preview.diffuser.random_walk import walk
from render.scene import Scene, load_scene, unchecked
from render.scene.faces import NamedFaces
from tests.oracles.pads import scene_of_case

RAYS, FEW = 60_000, 2_000


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("finger20")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def response(scene: Scene, folder: Path) -> SlabResponse:
    return slab_response(scene, cache=folder, rays=RAYS)


@pytest.fixture
def cached(scene: Scene, tmp_path: Path) -> tuple[Path, SlabResponse]:
    """A cache with one quick and rough response."""
    response = slab_response(scene, cache=tmp_path, rays=FEW)
    (path,) = tmp_path.glob("slab-*.npz")
    return path, response


def directions(count: int) -> np.ndarray:
    vectors = np.random.default_rng(0).standard_normal((count, 3))
    vectors[:, 1] = np.abs(vectors[:, 1])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_the_cache_answers_in_milliseconds_with_the_same_numbers(
    scene: Scene, folder: Path, response: SlabResponse
) -> None:
    start = time.process_time()
    again = slab_response(scene, cache=folder, rays=RAYS)
    assert time.process_time() - start < 0.1
    np.testing.assert_array_equal(again.radiance, response.radiance)
    assert again.albedo == response.albedo


@pytest.mark.parametrize("damage", ["cut", "flip", "foreign"])
def test_a_damaged_cache_file_is_made_again(
    scene: Scene, cached: tuple[Path, SlabResponse], damage: str
) -> None:
    path, response = cached
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:4000])
    elif damage == "flip":
        with np.load(path) as stored:
            arrays = dict(stored)
        arrays["radiance"][3, 2, 1, 0] *= 1.01
        np.savez(path, **arrays)
    else:
        np.savez(path, T=np.zeros(3))
    with pytest.warns(UserWarning, match="made again"):
        again = slab_response(scene, cache=path.parent, rays=FEW)
    np.testing.assert_array_equal(again.radiance, response.radiance)
    # The mended file is read without a warning.
    slab_response(scene, cache=path.parent, rays=FEW)


def test_another_material_has_a_file_of_its_own(
    scene: Scene, cached: tuple[Path, SlabResponse]
) -> None:
    path, response = cached
    layer = unchecked(scene.diffuser, {"sigma_a": 0.1})
    darker = unchecked(scene, {"diffuser": layer})
    other = slab_response(darker, cache=path.parent, rays=FEW)
    assert len(list(path.parent.glob("slab-*.npz"))) == 2
    assert other.power(np.array(1.5)) < response.power(np.array(1.5))


def test_an_unwritable_cache_is_no_obstacle(scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.warns(UserWarning, match="cannot be cached"):
        slab_response(scene, cache=tmp_path / "file", rays=FEW)


def test_no_light_is_negative(response: SlabResponse) -> None:
    radiance = response.radiance @ directional_terms(directions(500)).T
    assert radiance.min() > -0.02 * response.radiance[..., 0].max()
    assert (response.power(np.linspace(0, np.pi, 33)) > 0).all()


def test_phi_and_pi_minus_phi_are_mirror_images(response: SlabResponse) -> None:
    phi = np.array([0.0, 0.4, 1.2])
    mirrored = MIRROR_ALONG * response.at(np.pi - phi)[:, ::-1]
    np.testing.assert_allclose(response.at(phi), mirrored, atol=1e-12)


def test_between_the_nodes_the_response_is_what_a_walk_gives(
    scene: Scene, response: SlabResponse
) -> None:
    phi, slab = np.array([0.04, 0.35, 1.0]), slab_of(scene)
    assert not np.isin(phi, response.phi).any()
    rng = np.random.default_rng(5)
    photons, weight = emit_from_fiber(slab, fiber_end_of(scene), phi, 20_000, rng)
    left, _ = walk(slab, photons, rng)
    power = (left.weight[:, None] * weight[left.label]).sum(axis=0)
    np.testing.assert_allclose(response.power(phi), power, rtol=0.05)


def test_about_half_the_light_passes_and_half_comes_back(response: SlabResponse) -> None:
    assert response.power(np.array(np.pi / 2)) == pytest.approx(0.47, abs=0.01)
    assert response.albedo == pytest.approx(0.54, abs=0.02)


def test_the_moments_of_the_terms_are_integrals_over_the_hemisphere() -> None:
    terms = directional_terms(directions(400_000))
    cosine = terms[:, 6]
    sampled = 2 * np.pi * np.einsum("n,nk,nl->kl", cosine, terms, terms) / len(terms)
    np.testing.assert_allclose(moments(), sampled, atol=0.02)
    assert moments()[0, 0] == pytest.approx(np.pi)


def test_another_seed_changes_the_response_little(scene: Scene, response: SlabResponse) -> None:
    other = compute_response(slab_of(scene), fiber_end_of(scene), rays=20_000, seed=9)
    phi = np.linspace(0, np.pi, 5)
    np.testing.assert_allclose(other.power(phi), response.power(phi), rtol=0.06)


def test_an_opaque_layer_is_an_error_that_names_it(scene: Scene, tmp_path: Path) -> None:
    layer = unchecked(scene.diffuser, {"sigma_a": 10.0})
    with pytest.raises(RenderError, match=r"lets only .* allowed: at least 1e-06"):
        slab_response(unchecked(scene, {"diffuser": layer}), cache=tmp_path, rays=FEW)
    assert not list(tmp_path.iterdir())


def test_a_scene_without_diffuser_has_no_response(scene: Scene) -> None:
    with pytest.raises(RenderError, match="has no diffuser"):
        slab_of(unchecked(scene, {"diffuser": None}))


def test_the_layer_of_an_edge_has_the_roughness_of_its_faces() -> None:
    scene = scene_of_case("rim over smooth lower")
    assert (slab_of(scene, "tip").outer_roughness, slab_of(scene, "tip").lower_roughness) == (
        0.1,
        0,
    )
    edge = NamedFaces.model_construct(on=("tip",), roughness=0.3)
    scene = unchecked(scene, {"faces": (*(scene.faces or ()), edge)})
    assert slab_of(scene, "tip").outer_roughness == 0.3
    assert slab_of(scene, "left").outer_roughness == 0.1
    assert slab_of(scene, "tip").roughness == 0.1
