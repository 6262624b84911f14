"""Mirror connections over flat faces: stated densities, and the same pictures as without."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.integrators.mirror_connections import MirrorSet

A, Y = np.array([0.3, -0.2, -0.6]), np.array([-0.4, 0.5, 0.7])
COUNT = 1 << 16


def cube(mono: ModuleType, alpha: float, **parts: Any) -> Any:
    rough = {"type": "roughdielectric", "distribution": "beckmann", "alpha": alpha, "int_ior": 1.4}
    return mono.load_dict({"type": "scene", "cube": {"type": "cube", "bsdf": rough}, **parts})


def repeated(mono: ModuleType, p: np.ndarray, count: int) -> Any:
    return mono.Point3f(np.repeat(p[:, None], count, axis=1).astype(np.float32))


def found_mirrors(scene: Any) -> MirrorSet:
    mirrors = MirrorSet.of(scene)
    assert mirrors is not None
    return mirrors


def test_a_scene_without_flat_glossy_faces_has_no_mirrors(mono: ModuleType) -> None:
    assert MirrorSet.of(mono.load_dict(mono.cornell_box())) is None


def test_mirror_connections_find_each_point_of_the_faces_with_the_stated_density(
    mono: ModuleType,
) -> None:
    mirrors = found_mirrors(cube(mono, 0.3))
    rng = np.random.default_rng(1)
    numbers = (mono.Float(rng.random(COUNT).astype(np.float32)) for _ in range(3))
    a, y = repeated(mono, A, COUNT), repeated(mono, Y, COUNT)
    pick, u, v = numbers
    k, probability = mirrors.select(a, y, pick)
    lobe = mirrors.lobe(k, a, y)
    direction = lobe.sample(u, v)
    density = lobe.density(direction)
    density = density * probability
    assert (np.array(density) > 0).all()
    d = np.array(direction, dtype=np.float64).T
    # Where the ray leaves the cube; only the face that was aimed at counts.
    with np.errstate(divide="ignore"):
        t = np.where(d > 0, (1 - A) / d, (-1 - A) / d)
    axis = t.argmin(axis=1)
    b = A + t.min(axis=1)[:, None] * d
    normal = np.eye(3)[axis]
    there = mono.Point3f(np.ascontiguousarray(b.T).astype(np.float32))
    n = mono.Normal3f(np.ascontiguousarray(normal.T).astype(np.float32))
    meant = np.array(mirrors.mirror_at(there, n)) == np.array(k)
    area = np.array(mirrors.area_density(a, there, n, y), dtype=np.float64)
    expected = np.array(density) * np.abs((d * normal).sum(1)) / (t.min(axis=1) ** 2)
    np.testing.assert_allclose(area[meant], expected[meant], rtol=2e-3)

    # The density per area over all faces integrates to the fraction that arrived, per face.
    cells = 256
    grid = (np.arange(cells) + 0.5) / cells * 2 - 1
    u, v = (g.ravel() for g in np.meshgrid(grid, grid))
    for face in range(3):
        for side in (-1.0, 1.0):
            p = np.insert(np.stack([u, v]), face, side, axis=0).astype(np.float32)
            n = np.repeat(np.eye(3)[face][:, None], len(u), axis=1).astype(np.float32)
            wide_a, wide_y = (repeated(mono, q, len(u)) for q in (A, Y))
            area = np.array(
                mirrors.area_density(wide_a, mono.Point3f(p), mono.Normal3f(n), wide_y),
                dtype=np.float64,
            )
            fraction = area.sum() * (2 / cells) ** 2
            here = meant & (axis == face) & (np.sign(b[:, face]) == side)
            error = np.sqrt(fraction * (1 - fraction) / COUNT)
            assert abs(here.mean() - fraction) < 4 * error + 1e-3


def test_the_likely_image_is_that_in_the_mirror_that_is_selected_most_often(
    mono: ModuleType,
) -> None:
    mirrors = found_mirrors(cube(mono, 0.3))
    numbers = np.random.default_rng(3).random(COUNT)
    a, y = repeated(mono, A, COUNT), repeated(mono, Y, COUNT)
    k, _ = mirrors.select(a, y, mono.Float(numbers.astype(np.float32)))
    often = int(np.bincount(np.array(k)).argmax())
    expected = np.array(mirrors.image(mono.UInt32(often), a, y)[1])[:, 0]
    np.testing.assert_allclose(np.array(mirrors.likely_image(a, y))[:, 0], expected, rtol=1e-6)
    # An image lies as far behind one of the faces as the point before it.
    moved = np.flatnonzero(np.abs(expected - A) > 1e-6)
    assert len(moved) == 1
    assert abs(expected + A)[moved[0]] == pytest.approx(2.0, abs=1e-5)


@pytest.mark.parametrize("other", [[0.3, -0.2, -0.6], [0.3, 0.5, 1.0], [3.0, 0.0, 0.0]])
def test_points_in_a_face_or_outside_or_the_same_give_finite_densities(
    mono: ModuleType, other: list[float]
) -> None:
    mirrors = found_mirrors(cube(mono, 0.1))
    a, y = repeated(mono, A, 4), repeated(mono, np.array(other), 4)
    half = mono.Float([0.0, 0.3, 0.6, 0.99])
    k, probability = mirrors.select(a, y, half)
    lobe = mirrors.lobe(k, a, y)
    direction = lobe.sample(half, half)
    density = lobe.density(direction)
    density = density * probability
    dr.eval(direction, density)
    assert np.isfinite(np.array(direction)).all()
    assert np.isfinite(np.array(density)).all()
    assert (np.array(density) >= 0).all()


def lit(mono: ModuleType, medium: dict[str, Any] | None) -> Any:
    """Return a rough cube, clear or foggy, on a diffuse wall, lit from the side."""
    to = mono.ScalarTransform4f()
    inside = {"interior": {"type": "homogeneous", **medium}} if medium else {}
    rough = {"type": "roughdielectric", "distribution": "beckmann", "alpha": 0.15, "int_ior": 1.4}
    return mono.load_dict(
        {
            "type": "scene",
            "cube": {"type": "cube", "bsdf": rough, **inside},
            "wall": {
                "type": "rectangle",
                "to_world": to.translate([0, 0, 1.2]).rotate([0, 1, 0], 180).scale(4),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.7}},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": to.look_at(origin=[3, 2, -2], target=[0, 0, 0], up=[0, 1, 0]),
                "emitter": {"type": "area", "radiance": {"type": "uniform", "value": 10.0}},
            },
            "sensor": {
                "type": "perspective",
                "fov": 50,
                "to_world": to.look_at(origin=[0, 0, -5], target=[0, 0, 0], up=[0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
            },
        }
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    "medium",
    [None, {"sigma_t": 1.0, "albedo": 0.9, "phase": {"type": "hg", "g": 0.5}}],
    ids=["clear", "fog"],
)
def test_pictures_with_mirror_connections_and_shared_light_subpaths_equal_those_without(
    mono: ModuleType, medium: dict[str, Any] | None
) -> None:
    from render.integrators.film_sampler import FilmSampler
    from render.integrators.subpaths import PathLimits
    from render.sampling.monte_carlo import monte_carlo_replicates

    scene, lanes = lit(mono, medium), 1 << 15
    runs = []
    for seed, mirrored in enumerate((True, False)):
        sampler = FilmSampler(scene, scene.sensors()[0], PathLimits(max_depth=12))
        assert sampler.tracer.mirrors is not None
        sampler.tracer.mirrors = sampler.tracer.mirrors if mirrored else None
        # Those with mirrors share light subpaths as well; the others have each lane to itself.
        sampler = sampler.sharing(lanes, 16, 8) if mirrored else sampler
        runs.append(
            monte_carlo_replicates(sampler, lanes=lanes, passes=8, replicates=16, seed=seed)[..., 0]
        )
    means = [run.mean(axis=0) for run in runs]
    error = np.sqrt(sum(run.var(axis=0, ddof=1) / 16 for run in runs))
    score = np.abs(means[0] - means[1]) / error
    # Student's t with 15 degrees of freedom.
    assert (score < 2.13).mean() > 0.7
    assert score.max() < 5
    total = [run.mean(axis=1) for run in runs]
    bar = np.sqrt(sum(t.var(ddof=1) / 16 for t in total))
    assert abs(total[0].mean() - total[1].mean()) < 4 * bar
    assert bar < 0.02 * total[0].mean()
