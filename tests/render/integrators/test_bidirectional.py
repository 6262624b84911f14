"""The integrators ``bdpt`` and ``pssmlt`` on scenes with known answers."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np
import pytest

from render.errors import RenderError

SIZE = 8
CHAINS = {"chains": 4096, "luminance_samples": 16384, "chains_only": True}
POINT = np.array([0.6, 0.3, 2.0])


def sensor(mono: ModuleType, origin: list[float], kind: str = "perspective") -> dict[str, Any]:
    to_world = mono.ScalarTransform4f().look_at(origin=origin, target=[0, 0, 0], up=[0, 1, 0])
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    lens = {"fov": 40} if kind == "perspective" else {}
    return {"type": kind, "to_world": to_world, "film": film, **lens}


def plane(mono: ModuleType, **parts: Any) -> Any:
    light = {"type": "point", "position": POINT.tolist(), "intensity": 3.0}
    content = {
        "type": "scene",
        "sensor": sensor(mono, [0, 0, 5]),
        "plane": {
            "type": "rectangle",
            "to_world": mono.ScalarTransform4f().scale(50),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.5}},
        },
        "light": light,
    }
    return mono.load_dict({k: v for k, v in (content | parts).items() if v is not None})


def image(mono: ModuleType, scene: Any, spp: int, **parameters: Any) -> np.ndarray:
    integrator = mono.load_dict({"error_bars": True, **parameters})
    return np.array(integrator.render(scene, spp=spp), dtype=np.float64)


def lambert() -> np.ndarray:
    """Return albedo / pi * I cos / r^2 averaged over each pixel, ``(row, column)``."""
    fine = SIZE * 16
    half = np.tan(np.radians(20)) * 5
    across = (1 - 2 * (np.arange(fine) + 0.5) / fine) * half
    # This camera's image x runs towards -x of the scene when it looks along +z; here along -z.
    x, y = np.meshgrid(-across, across)
    squared = (x - POINT[0]) ** 2 + (y - POINT[1]) ** 2 + POINT[2] ** 2
    radiance = 0.5 / np.pi * 3.0 * POINT[2] / squared**1.5
    return radiance.reshape(SIZE, 16, SIZE, 16).mean(axis=(1, 3))


@pytest.mark.slow
@pytest.mark.parametrize("parameters", [{"type": "bdpt"}, {"type": "pssmlt", **CHAINS}])
def test_a_point_light_over_a_diffuse_plane_follows_lamberts_law(
    mono: ModuleType, parameters: dict[str, Any]
) -> None:
    result = image(mono, plane(mono), 4096, **parameters)
    score = np.abs(result[..., 0] - lambert()) / result[..., 1]
    # Student's t with 7 degrees of freedom: 0.95 and 0.9999 quantiles.
    assert (score < 2.365).mean() > 0.85
    assert score.max() < 8
    assert result[..., 0].mean() == pytest.approx(lambert().mean(), rel=0.01)


@pytest.mark.parametrize("depth", [2, 3])
def test_max_depth_counts_edges_as_mitsubas_path_does(mono: ModuleType, depth: int) -> None:
    box = mono.cornell_box() | {"sensor": sensor(mono, [0, 0, 3.9])}
    scene = mono.load_dict(box)
    path = mono.load_dict({"type": "path", "max_depth": depth})
    # The lamp itself is bright and small; what it lights says more about depth.
    dim = (slice(3, None), slice(None))
    runs = np.stack(
        [np.array(mono.render(scene, integrator=path, spp=256, seed=s))[..., 0] for s in range(8)]
    )
    truth = runs.mean(axis=0)[dim]
    error = runs.std(axis=0, ddof=1)[dim] / np.sqrt(8)
    result = image(mono, scene, 1024, type="bdpt", max_depth=depth)[dim]
    bar = np.sqrt((error**2 + result[..., 1] ** 2).sum()) / truth.size
    assert abs(result[..., 0].mean() - truth.mean()) < 4 * bar
    assert result[..., 0].mean() == pytest.approx(truth.mean(), rel=0.03)


def test_without_a_bounce_a_lit_plane_stays_exactly_black(mono: ModuleType) -> None:
    assert (image(mono, plane(mono), 64, type="bdpt", max_depth=1) == 0).all()


def test_error_bars_append_one_channel_per_color(mono: ModuleType) -> None:
    scene = plane(mono)
    bare = mono.load_dict({"type": "bdpt"})
    assert np.array(bare.render(scene, spp=64)).shape == (SIZE, SIZE, 1)
    assert bare.aov_names() == []
    result = image(mono, scene, 64, type="bdpt")
    assert result.shape == (SIZE, SIZE, 2)
    assert (result[..., 1] > 0).all()
    # The film holds what was rendered last, and not what was before.
    np.testing.assert_array_equal(np.array(scene.sensors()[0].film().bitmap()), result)
    assert mono.load_dict({"type": "bdpt", "error_bars": True}).aov_names() == ["standard_error.Y"]


def test_a_seed_gives_the_same_picture_again_and_another_seed_another(mono: ModuleType) -> None:
    scene = plane(mono)
    integrator = mono.load_dict({"type": "pssmlt", **CHAINS})
    first, again, other = (np.array(integrator.render(scene, seed=s, spp=64)) for s in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize("kind", ["bdpt", "pssmlt"])
@pytest.mark.parametrize(
    ("parts", "named"),
    [
        ({"light": None}, "no emitter"),
        ({"light": {"type": "projector"}}, "allowed: area, point, spot, directional"),
        ({"sensor": "orthographic"}, "allowed: perspective"),
        (
            {
                "fog": {
                    "type": "sphere",
                    "bsdf": {"type": "null"},
                    "interior": {
                        "type": "heterogeneous",
                        "albedo": 0.5,
                        "sigma_t": {"type": "constvolume", "value": 1.0},
                    },
                }
            },
            "heterogeneous",
        ),
    ],
)
def test_what_the_sampler_does_not_support_is_refused_by_name(
    mono: ModuleType, kind: str, parts: dict[str, Any], named: str
) -> None:
    if parts.get("sensor") == "orthographic":
        parts = {"sensor": sensor(mono, [0, 0, 5], "orthographic")}
    scene = plane(mono, **parts)
    with pytest.raises(RenderError, match=named):
        mono.load_dict({"type": kind}).render(scene, spp=1)


@pytest.mark.parametrize("kind", ["bdpt", "pssmlt"])
def test_a_lamp_inside_an_opaque_part_lights_nothing_and_says_so(
    mono: ModuleType, kind: str
) -> None:
    lamp = {"type": "point", "position": [0, 0, 3], "intensity": 1.0}
    around = {"type": "sphere", "center": [0, 0, 3], "radius": 0.5, "bsdf": {"type": "diffuse"}}
    scene = plane(mono, light=lamp, around=around)
    with pytest.raises(RenderError, match=r"no light arrives .* lamps inside opaque parts"):
        mono.load_dict({"type": kind}).render(scene, spp=4)


def test_a_grid_of_distances_is_refused_by_name(mono: ModuleType) -> None:
    distances = np.linspace(-1.0, 1.0, 64, dtype=np.float32).reshape(4, 4, 4, 1)
    part = {"type": "sdfgrid", "grid": mono.TensorXf(distances)}
    with pytest.raises(RenderError, match="'part' is an sdfgrid"):
        mono.load_dict({"type": "bdpt"}).render(plane(mono, part=part), spp=1)


def test_a_metropolis_setting_out_of_range_is_named(mono: ModuleType) -> None:
    scene = plane(mono)
    with pytest.raises(RenderError, match="p_large"):
        mono.load_dict({"type": "pssmlt", "p_large": 2.0}).render(scene, spp=1)
