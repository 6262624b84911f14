"""A slab with a scattering layer against three renderers that share no code with this one.

``slab_disk_beckmann_blocks.npz`` holds means over 8x8 pixels, ``(8, 12)`` blocks of a 96 x 64
image, and their standard errors, of the scene below: ``bdpt06`` and ``pssmlt06`` by Mitsuba 0.6's
integrators of those names, ``analog`` by an analog Monte Carlo written from scratch. The lamp is
at the left; where the coating is seen, from block column 2 on, every method resolves the light.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy import stats

BLOCKS = Path(__file__).with_name("slab_disk_beckmann_blocks.npz")
COATED = np.s_[:, 2:]
SPP = 192
RUNS = {"analog": 12, "bdpt06": 8, "pssmlt06": 3}
"""Independent runs behind the standard errors of each renderer."""
Corner = tuple[float, float, float]


def face(low: Corner, high: Corner, outward: Corner) -> trimesh.Trimesh:
    """Return the rectangle with two opposite corners, whose normal is ``outward``."""
    a, c = np.array(low, dtype=float), np.array(high, dtype=float)
    first, second = (i for i in range(3) if a[i] != c[i])
    b, d = a.copy(), a.copy()
    b[first], d[second] = c[first], c[second]
    corners, triangles = np.array([a, b, c, d]), np.array([[0, 1, 2], [0, 2, 3]])
    if np.cross(b - a, c - a) @ np.array(outward) < 0:
        triangles = triangles[:, ::-1]
    return trimesh.Trimesh(corners, triangles, process=False)


PARTS = {
    "clear": [
        face((-8, -12, 0), (8, 12, 0), (0, 0, -1)),
        face((-8, -12, 0), (-8, 12, 4), (-1, 0, 0)),
        face((-8, -12, 0), (8, -12, 4), (0, -1, 0)),
        face((-8, 12, 0), (8, 12, 4), (0, 1, 0)),
    ],
    "layer": [
        face((8, -12, 0), (10, 12, 0), (0, 0, -1)),
        face((8, -12, 4), (10, 12, 4), (0, 0, 1)),
        face((10, -12, 0), (10, 12, 4), (1, 0, 0)),
        face((8, -12, 0), (10, -12, 4), (0, -1, 0)),
        face((8, 12, 0), (10, 12, 4), (0, 1, 0)),
    ],
    "interface": [face((8, -12, 0), (8, 12, 4), (-1, 0, 0))],
    "coating": [face((-8, -12, 4), (8, 12, 4), (0, 0, -1))],
}


def lamp(mono: ModuleType) -> dict[str, Any]:
    """Return the disk of uniform radiance in front of the layer."""
    transform = mono.ScalarTransform4f()
    return {
        "type": "disk",
        "to_world": transform.translate([10.4, 0, 2]).rotate([0, 1, 0], -90).scale(0.375),
        "emitter": {"type": "area", "radiance": {"type": "uniform", "value": 1000.0}},
    }


def slab(mono: ModuleType, folder: Path, light: dict[str, Any]) -> Any:
    """Return the box [-8, 10] x [-12, 12] x [0, 4] mm: x > 8 scatters, z = 4 is coated to x = 8."""
    rough = {
        "type": "roughdielectric", "distribution": "beckmann", "alpha": 0.1,
        "int_ior": 1.41, "ext_ior": 1.0,
    }  # fmt: skip
    inside = {"interior": {"type": "ref", "id": "milk"}}
    extras = {
        "clear": {"bsdf": rough},
        "layer": {"bsdf": rough, **inside},
        "interface": {"bsdf": {"type": "null"}, **inside},
        "coating": {"bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.7}}},
    }
    shapes = {}
    for name, faces in PARTS.items():
        path = folder / f"{name}.ply"
        path.write_bytes(trimesh.util.concatenate(faces).export(file_type="ply"))
        shapes[name] = {"type": "ply", "filename": str(path), "face_normals": True, **extras[name]}
    transform = mono.ScalarTransform4f()
    return mono.load_dict(
        {
            "type": "scene",
            "milk": {
                "type": "homogeneous", "id": "milk", "sigma_t": 2.005, "albedo": 2.0 / 2.005,
                "phase": {"type": "hg", "g": 0.6},
            },
            **shapes,
            "lamp": light,
            "sensor": {
                "type": "perspective", "fov": 80, "fov_axis": "x",
                "to_world": transform.look_at(origin=[0, 0, -10], target=[0, 0, 0], up=[0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 96, "height": 64, "rfilter": {"type": "box"}},
            },
        }
    )  # fmt: skip


def blocks(picture: np.ndarray) -> np.ndarray:
    """Return means over 8x8 pixels of ``(replicate, 64, 96)`` pictures."""
    return picture.reshape(-1, 8, 8, 12, 8).mean(axis=(2, 4))


@pytest.fixture(scope="module")
def ours(mono: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    """Return the block means of independent replicates ``(replicate, 8, 12)``."""
    from render.integrators.film_sampler import FilmSampler

    scene = slab(mono, tmp_path_factory.mktemp("slab"), lamp(mono))
    integrator = mono.load_dict({"type": "bdpt", "replicates": 16})
    sampler = FilmSampler(scene, scene.sensors()[0], integrator.limits)
    replicates = integrator.replicate_images(sampler, 5, SPP)
    return blocks(replicates.reshape(-1, 64, 96))


@pytest.mark.parametrize("renderer", ["analog", "bdpt06", "pssmlt06"])
def test_the_coated_part_looks_as_in_other_renderers(ours: np.ndarray, renderer: str) -> None:
    with np.load(BLOCKS) as stored:
        theirs, their_error = stored[renderer], stored[f"{renderer}_se"]
    mean, error = ours.mean(axis=0), ours.std(axis=0, ddof=1) / np.sqrt(len(ours))
    score = ((mean - theirs) / np.hypot(error, their_error))[COATED]
    # Student's t with their degrees of freedom, fewer than ours: 95 % of the blocks lie within.
    # From three runs of Metropolis an error bar says little: pssmlt06 and analog differ as much.
    within = stats.t.ppf(0.975, RUNS[renderer] - 1)
    print(f"{renderer}: {(np.abs(score) < within).mean():.1%} of the blocks within {within:.2f}")
    assert (np.abs(score) < within).mean() > 0.875
    assert mean[COATED].mean() == pytest.approx(theirs[COATED].mean(), rel=0.02)
