"""Images over facing mirrors of a pad with a layer: what has them, and what they carry."""

from __future__ import annotations

import itertools
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.arrays import Array
from render.cells.box_images import BoxImages, repeating_axes
from render.paths.vertex import empty_vertex
from render.scene import Scene
from tests.oracles.pads import content_of_case, scene_of_case
from tests.render.cells.test_box_images import straight_to_the_glow

A, Y = np.array([-7.0, 2.0, 4.3]), np.array([-11.2, -3.0, 3.7])
"""A tilted facet, and a place in the layer on the left; mm."""
NORMAL = np.array([-np.sin(0.5), 0.0, -np.cos(0.5)])
METAL = 0.3


@pytest.fixture(scope="module")
def scene() -> Scene:
    """A layer that is all but clear, on a pad whose other edges are metal."""
    content = content_of_case("thin rim between mirrors")
    for name in ("sigma_s", "sigma_a"):
        content["diffuser"][name]["value"] = 1e-6
    content["faces"][0]["mirror"]["value"] = METAL
    return Scene.model_validate(content)


@pytest.mark.parametrize(
    ("case", "axes"),
    [
        ("smooth", (False, False, False)),
        ("clear rim", (False, False, False)),
        ("rim rough 0.1", (False, False, False)),
        ("rim over smooth lower", (False, False, False)),
        ("rim", (True, True, True)),
        ("thin rim between mirrors", (True, True, True)),
    ],
)
def test_only_pads_that_scatter_between_mirrors_have_repeated_images(
    case: str, axes: tuple[bool, bool, bool]
) -> None:
    assert repeating_axes(scene_of_case(case)) == axes


def test_an_image_of_order_k_lies_k_boxes_away(mono: ModuleType, scene: Scene) -> None:
    images = BoxImages(scene)
    p = mono.Point3f(*Y.tolist())
    # Digits of orders 0, -1, 1, -2, 2; the box is 22 x 24 x 4.5 mm.
    for digit, x in enumerate((Y[0], -24.0 - Y[0], 20.0 - Y[0], Y[0] - 44.0, Y[0] + 44.0)):
        found = np.array(images.point(mono.UInt32(digit), p)).ravel()
        np.testing.assert_allclose(found, [x, Y[1], Y[2]], rtol=1e-6)


def fresnel(cosine: float, n: float) -> float:
    squared = 1 - n**2 * (1 - cosine**2)
    if squared <= 0:
        return 1.0
    out = np.sqrt(squared)
    s, p = (n * cosine - out) / (n * cosine + out), (cosine - n * out) / (cosine + n * out)
    return float((s**2 + p**2) / 2)


def carried(scene: Scene, orders: tuple[int, ...]) -> float:
    """Return what the mirrors on the way from `A` to an image of `Y` reflect, 0 if it is blocked.

    The way is followed from plane to plane of the box; the coating is over all but the layer.
    """
    low, high = scene.box.low, scene.box.high
    n = scene.pad.index
    image = np.array(
        [
            y + k * (b - a) if k % 2 == 0 else a + b - y + k * (b - a)
            for y, k, a, b in zip(Y, orders, low, high, strict=True)
        ]
    )
    left = np.linalg.norm(image - A)
    p, d, share = A.copy(), (image - A) / left, 1.0
    while True:
        steps = np.where(d > 0, high - p, low - p) / np.where(d == 0, 1e-30, d)
        axis = int(steps.argmin())
        if steps[axis] >= left:
            np.testing.assert_allclose(p + left * d, Y, atol=1e-6)
            return share
        p, left = p + steps[axis] * d, left - steps[axis]
        if axis == 2 and d[2] > 0 and p[0] > -scene.pad.width / 2:
            return 0.0
        metal = axis == 1 or (axis == 0 and d[0] > 0)
        share *= METAL if metal else fresnel(abs(d[axis]), n)
        d[axis] = -d[axis]


def test_light_of_a_volume_comes_over_mirrors_of_all_orders(mono: ModuleType, scene: Scene) -> None:
    from render.optics.pad_scene import pad_scene

    pad: Any = pad_scene(scene, 0.0, False)
    bsdf = mono.load_dict({"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.5}})
    phase = mono.load_dict({"type": "isotropic"})
    count = 1 << 19

    def places(p: Array) -> Any:
        return mono.Point3f(*[dr.full(mono.Float, c, count) for c in p.tolist()])

    a, y = empty_vertex(), empty_vertex()
    a.p, a.n, a.diffuse = places(A), mono.Normal3f(*NORMAL.tolist()), mono.Bool(True)
    a.bsdf, a.frame = mono.BSDFPtr(bsdf), mono.Frame3f(mono.Vector3f(*NORMAL.tolist()))
    a.wi = mono.Vector3f(*NORMAL.tolist())
    a.shape = mono.ShapePtr(next(s for s in pad.shapes() if s.id() == "coating"))
    y.p, y.phase, y.volume, y.terminal = (
        places(Y), mono.PhaseFunctionPtr(phase), mono.Bool(True), mono.Bool(True),
    )  # fmt: skip
    for v in (a, y):
        v.beta, v.weight = mono.Spectrum(1.0), mono.Float(1.0)
    images = BoxImages(scene)
    rng = np.random.default_rng(5)
    number, *candidates = (
        [mono.Float(rng.random(count).astype(np.float32)) for _ in range(4)]
        for _ in range(1 + images.repeated)
    )
    guiding = straight_to_the_glow(mono, scene, count)
    active = dr.full(mono.Bool, True, count)
    found = images.connect(
        pad, y, a, number[0], active, guiding, candidates=[tuple(event) for event in candidates]
    )
    values = np.array(found, dtype=np.float64).ravel()
    # Every order, by the inverse square law; the near ones are those of a box without repetition.
    total, near = 0.0, 0.0
    for orders in itertools.product(range(-9, 10), range(-6, 7), range(-6, 7)):
        if not any(orders):
            continue
        span = np.array(
            [
                (p + k * (b - a) if k % 2 == 0 else a + b - p + k * (b - a)) - q
                for p, q, k, a, b in zip(Y, A, orders, scene.box.low, scene.box.high, strict=True)
            ]
        )
        cosine = NORMAL @ span / np.linalg.norm(span)
        if cosine > 0:
            light = carried(scene, orders) * cosine * 0.5 / np.pi / (4 * np.pi) / (span @ span)
            total += light
            near += light * (max(map(abs, orders[:2])) < 2 and orders[2] in (0, -1))
    error = values.std() / np.sqrt(count)
    assert near < 0.95 * total
    assert error < 0.01 * total
    assert abs(values.mean() - total) < 4 * error
