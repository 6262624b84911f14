"""The basis in the facet normal."""

from __future__ import annotations

import numpy as np
import torch

from render.geometry import facet_normals, flat_fiber_poses, flat_sites, mirror_twins
from render.scene import Scene
from surrogate.model.facet_basis import SIZE, Expansion, facet_harmonics, harmonics


def _expand(scene: Scene, index: int, log_preview: torch.Tensor | None = None) -> np.ndarray:
    """Return basis function ``index``, ``(fiber, site, normal)``."""
    shape = (1, scene.lamp_count, 1, scene.sites.count)
    if log_preview is None:
        log_preview = torch.zeros(scene.indenter.faces + 1, *shape)
    unit = torch.zeros(1, SIZE, *shape)
    unit[:, index] = 1.0
    return np.moveaxis(Expansion(scene)(unit, log_preview)[0, :, 0, :, 0].numpy(), 0, -1)


def test_the_untouched_pad_sees_only_the_constant(scene: Scene) -> None:
    assert facet_harmonics(scene)[-1].tolist() == [1.0, 0, 0, 0, 0, 0, 0, 0]


def test_harmonics_of_a_steepest_facet_lie_on_the_unit_circle(scene: Scene) -> None:
    basis = harmonics(facet_normals(scene), scene.indenter.slope)
    for pair in ((1, 2), (3, 4), (5, 6)):
        np.testing.assert_allclose((basis[:, pair] ** 2).sum(axis=1), 1.0, rtol=1e-12)


def test_the_first_local_harmonic_is_the_normal_along_the_direction_from_fiber_to_site(
    scene: Scene,
) -> None:
    offset = flat_sites(scene)[None, :, :2] - flat_fiber_poses(scene).position[:, None, :2]
    unit = offset / np.linalg.norm(offset, axis=-1, keepdims=True)
    normal = facet_normals(scene)[:, :2] / np.sin(scene.indenter.slope)
    found = _expand(scene, 1)[..., :-1]
    np.testing.assert_allclose(found, np.einsum("fsc,kc->fsk", unit, normal), atol=1e-6)


def test_every_basis_function_of_a_twin_is_the_mirror_image(scene: Scene) -> None:
    sites = np.arange(scene.sites.count).reshape(scene.sites.rows, scene.sites.columns)
    faces = scene.indenter.faces
    facets = [*(-np.arange(faces) % faces), faces]
    for index in range(SIZE):
        here = _expand(scene, index)
        there = here[mirror_twins(scene).twin][:, sites[:, ::-1].ravel()][..., facets]
        np.testing.assert_allclose(here, there, atol=1e-6)


def test_contrast_terms_leave_the_untouched_pad_alone_and_stay_bounded(scene: Scene) -> None:
    shape = (1, scene.lamp_count, 1, scene.sites.count)
    log_preview = torch.zeros(scene.indenter.faces + 1, *shape)
    log_preview[0], log_preview[1] = -40.0, 40.0
    first, second = (_expand(scene, SIZE - k, log_preview) for k in (2, 1))
    assert (first[..., -1] == 0).all()
    np.testing.assert_allclose(first[..., :2], np.broadcast_to([-1, 1], (*first.shape[:2], 2)))
    np.testing.assert_allclose(second, first**2)
