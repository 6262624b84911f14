"""The shader against the same formula in float64 numpy, in world coordinates.

Straight ways come from world positions; the mirrored way is found by bisection (the shader takes
three Newton steps in the pad's own coordinates). Where a way is just about hidden the two differ by
more than rounding, hence the absolute part of the tolerance. Edge patches of a bent pad are left
out: at middle height they see several reflections in the arc, of which each side finds one.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from render.geometry import bend_frames, bend_points, curvature, fresnel
from render.preview import Preview, point_lights
from render.preview.diffuser.basis import directional_terms
from render.preview.light_paths import near_wall, wall_image
from render.preview.lights import PointLights
from render.preview.shading_points import ShadingPoints, shading_points
from render.scene import OUTWARD, Scene, load_scene, unchecked
from tests.oracles.pads import scene_of_case

RELATIVE, ABSOLUTE, MEDIAN = 1e-3, 2e-6, 2e-5
FEW = 0.04
"""Part of the points that may leave the tolerance in a sensor at the end of a range: deep facets
lie at middle height as well, and a beam of 0.1 deg turns rounding into percents."""
AT_BORDERS = 0.002
"""Part of the points that see a lamp just at the border of the face that it shines through."""
PAINTED = (
    "white, mirror and black walls", "mirrors all round, lit from below",
    "mirror base beside a rim rough 0.1", "white base beside a rim rough 0.1",
)  # fmt: skip
PLAIN = (*PAINTED, "diffuser", "bare", "thin diffuser", "below", "rows of their own", "base")


def with_parts(scene: Scene, **parts: object) -> Scene:
    return unchecked(scene, parts)


def soft_inverse_square(squared: np.ndarray, lights: PointLights) -> np.ndarray:
    soft = float(lights.defines["SOFT_RADIUS"]) ** 2
    return 1 / (squared + soft**2 / (squared + soft))


def to_face(local: np.ndarray, face: np.ndarray) -> np.ndarray:
    """Turn local pad directions into (along the face, into the pad, up)."""
    x, y, z = np.moveaxis(local, -1, 0)
    face = face.astype(int)
    along = np.where(face % 2 == 1, x, np.where(face == 4, x, y))
    into = np.choose(face, [x, -y, -x, y, z])
    return np.stack(np.broadcast_arrays(along, into, np.where(face == 4, y, z)), axis=-1)


def seen_through(scene: Scene, image: np.ndarray, target: np.ndarray, face: int):
    """Return where a lamp in air seems to be, and the factor on 1/d^2, by bisection of Snell's law.

    ``image (3,)`` is the paraxial one, ``target (point, 3)``.
    """
    inward, box, n = -OUTWARD[face], scene.box, scene.pad.index
    corner = np.where(inward > 0, box.low, box.high)
    outside = max(float((corner - image) @ inward), 1e-4) / n
    inside = (target - corner) @ inward
    across = (target - image) * (inward == 0)
    reach = np.linalg.norm(across, axis=-1)
    low, high = np.zeros_like(reach), reach.copy()
    for _ in range(80):
        lateral = 0.5 * (low + high)
        bent = n * lateral / np.hypot(lateral, inside) < (reach - lateral) / np.hypot(
            reach - lateral, outside
        )
        low, high = np.where(bent, lateral, low), np.where(bent, high, lateral)
    lateral = 0.5 * (low + high)
    in_cos = inside / np.hypot(lateral, inside)
    out_cos = outside / np.hypot(reach - lateral, outside)
    axial = reach <= 1e-3 * inside
    seen = np.where(axial, n * outside, inside * (reach - lateral) / np.where(axial, 1, lateral))
    # The ray tube: how far the point of arrival moves as the lamp's ray turns.
    moves = outside / out_cos**2 + inside * out_cos / (n * in_cos**3)
    factor = out_cos * (inside + seen) / (n * in_cos**3 * moves)
    entry = image + across * ((reach - lateral) / np.maximum(reach, 1e-6))[:, None]
    entry = np.where(inward != 0, corner, entry)
    within = (entry >= box.low) & (entry <= box.high)
    if face == 4:
        half = np.array([scene.pad.width, scene.pad.length]) / 2
        within[:, :2] &= np.abs(entry[:, :2]) <= half
    place = np.where(inward != 0, corner - seen[:, None] * inward, image)
    return place, np.where(within.all(axis=-1) & (inside > 0), factor, 0.0)


def straight(scene: Scene, lights: PointLights, source, target, bend: float):
    way = bend_points(scene, target, bend) - bend_points(scene, source, bend)
    squared = (way**2).sum(axis=-1)
    unit = way / np.sqrt(squared)[..., None]
    depart = np.einsum("...ji,...j->...i", bend_frames(scene, source[..., 1], bend), unit)
    arrive = -np.einsum("...ji,...j->...i", bend_frames(scene, target[..., 1], bend), unit)
    visible = np.ones_like(squared)
    kappa = curvature(scene, bend)
    if kappa:
        thickness = scene.pad.thickness
        dip = np.sqrt((1 + kappa * (thickness - target[..., 2])) ** 2 - 1)
        back = arrive * np.sqrt(squared)[..., None]
        cell = 2 * np.minimum(thickness - source[..., 2], thickness / 4)
        sunk = np.clip(0.5 + (dip * np.abs(back[..., 1]) - back[..., 2]) / cell, 0, 1)
        ahead = np.cos(kappa * (target[..., 1] - source[..., 1])) > 0
        visible = np.where((np.abs(back[..., 1]) <= dip / kappa) & ahead, 1.0, sunk)
        visible = visible * (np.abs(kappa * (target[..., 1] - source[..., 1])) < np.pi)
    return depart, arrive, visible * soft_inverse_square(squared, lights)


def mirrored(scene: Scene, lights: PointLights, source, target, bend: float):
    kappa, index = curvature(scene, bend), scene.pad.index
    across, along, _ = np.moveaxis(target - source, -1, 0)
    a, c = np.broadcast_arrays(source[..., 2], target[..., 2])
    if not kappa:
        squared = across**2 + along**2 + (a + c) ** 2
        scale = 1 / np.sqrt(squared)
        depart = np.stack([across, along, -(a + c)], axis=-1) * scale[..., None]
        reflected = fresnel((a + c) * scale, 1 / index)[0]
        spread = soft_inverse_square(squared, lights) * reflected
        return depart, depart * [-1, -1, 1], spread
    radius = 1 / kappa + scene.pad.thickness
    arc, sign = kappa * np.abs(along), np.sign(along)
    low, high = np.zeros_like(arc), arc
    for _ in range(60):
        theta = 0.5 * (low + high)
        psi = arc - theta
        first = (radius - a) * np.sin(theta) * (radius - (radius - c) * np.cos(psi))
        second = (radius - c) * np.sin(psi) * (radius - (radius - a) * np.cos(theta))
        low, high = np.where(first < second, theta, low), np.where(first < second, high, theta)
    theta, psi = 0.5 * (low + high), arc - 0.5 * (low + high)
    # In the plane of the arc, from source (first) and target (second) to the reflection.
    t1, d1 = radius * np.sin(theta), a - radius * (1 - np.cos(theta))
    t2, d2 = radius * np.sin(psi), c - radius * (1 - np.cos(psi))
    l1, l2 = np.hypot(t1, d1), np.hypot(t2, d2)
    total = l1 + l2
    squared = total**2 + across**2
    depart = np.stack([across * l1 / total, sign * t1, -d1], axis=-1)
    arrive = np.stack([-across * l2 / total, -sign * t2, -d2], axis=-1)
    plane_cosine = (radius - (radius - a) * np.cos(theta)) / l1
    width = np.maximum(total - 2 * l1 * l2 / (radius * plane_cosine), 0.1 * total)
    dip = np.sqrt((1 + kappa * (scene.pad.thickness - c)) ** 2 - 1)
    visible = (arc < np.pi) * np.clip(10 * d1 / a, 0, 1) * np.clip(10 * (dip * t2 + d2) / c, 0, 1)
    reflected = fresnel(np.clip(plane_cosine * total / np.sqrt(squared), 0, 1), 1 / index)[0]
    spread = visible * reflected * total / width * soft_inverse_square(squared, lights)
    unit = [v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (depart, arrive)]
    return unit[0], unit[1], spread


def glow_intensity(emission, direction) -> np.ndarray:
    """Return intensities for ``(n,)`` emission and directions ``(point, 3)``."""
    return directional_terms(direction) @ emission[:9] * np.maximum(direction[..., 1], 0.0)


def beam_intensity(scene: Scene, emission, direction, face: int, profile) -> np.ndarray:
    n, layer = scene.pad.index, scene.diffuser
    cosine = np.maximum(direction[..., 1], 0.0)
    side = n * direction[..., [0, 2]]
    inside = (side**2).sum(axis=-1) < 1
    height = np.sqrt(np.where(inside, 1 - (side**2).sum(axis=-1), 1.0))
    air = np.stack([side[..., 0], height, side[..., 1]], axis=-1)
    towards = np.clip(air @ emission[:3], -1, 1)
    safe = np.maximum(cosine, 1e-12)
    depth = (layer.sigma_s + layer.sigma_a) * layer.thickness if layer and face < 3 else 0.0
    passed = (1 - fresnel(cosine, 1 / n)[0]) * np.exp(-depth / safe) * n**2 * cosine / height
    ray = emission[3] * profile.shape(np.arccos(towards)) * passed
    return np.where(inside & (cosine > 0), ray, 0.0)


def embedded_intensity(emission, direction, profile) -> np.ndarray:
    towards = np.clip(direction @ emission[:3], -1, 1)
    return emission[3] * profile.shape(np.arccos(towards))


def unfolded(scene: Scene, target: np.ndarray, turns: tuple[int, int]):
    """Return where targets are after reflections at walls, one by one, and the signs turned."""
    target, flip = target.copy(), np.ones(3)
    for axis, count in enumerate(turns):
        low, high = scene.box.low[axis], scene.box.high[axis]
        for _ in range(abs(count)):
            # The wall that the last image ended at.
            target[:, axis] = 2 * (high if count > 0 else low) - target[:, axis]
            flip[axis] = -flip[axis]
            low, high = (high, 2 * high - low) if count > 0 else (2 * low - high, low)
    return target, flip


def edge_reflects(scene: Scene, axis: int, high: bool, cosine: np.ndarray) -> np.ndarray:
    """Return what the edge of high or low x or y reflects of light at ``cosine``."""
    paint = scene.finish((("left", "right"), ("base", "tip"))[axis][high]).paint
    if paint is not None:
        return np.full_like(cosine, paint.reflectance if paint.mirror else 0.0)
    return fresnel(np.minimum(cosine, 1.0), 1 / scene.pad.index)[0]


def irradiance(
    scene: Scene, lights: PointLights, points: ShadingPoints, phi, bend: float
) -> np.ndarray:
    """Return direct irradiance at points and at their facets' feet, ``(fiber, node, point, 2)``."""
    emissions = lights.emission(phi.T).swapaxes(0, 1)
    result = np.zeros((*phi.shape, len(points.position), 2))
    base, lamps = wall_image(scene, (0, -1)), scene.placed_lamps()
    for fiber, light in itertools.product(range(len(phi)), range(lights.position.shape[1])):
        place, mark = lights.position[fiber, light, :3], int(lights.position[fiber, light, 3])
        face, beam = mark % 8, mark // 8 % 2
        turns = (mark // 16 % 16 - 8, mark // 256 % 16 - 8) if beam else (0, 0)
        embedded = beam and mark >= 8192
        near = not beam and base.distance(place) < near_wall(scene)
        for way, in_base in itertools.product((straight, mirrored), (False, True)):
            source, target, factor = place, points.position, np.ones(len(points.position))
            if in_base and not near:
                continue
            target, flip = unfolded(scene, target, turns)
            if beam and not embedded:
                if way is mirrored and face == 4:
                    continue
                aim = target * [1, 1, -1] if way is mirrored else target
                source, factor = seen_through(scene, place, aim, face)
                if way is mirrored:
                    source = np.maximum(source, [-np.inf, -np.inf, 1e-3 * scene.pad.thickness])
            source = base.image(source) if in_base else source
            depart, arrive, spread = way(scene, lights, np.broadcast_to(source, target.shape),
                                         target, bend)  # fmt: skip
            if in_base:
                spread = spread * edge_reflects(scene, 1, False, np.abs(depart[..., 1]))
                depart = depart * [1, -1, 1]
            for axis in (0, 1):
                for count in range(abs(turns[axis])):
                    high = (turns[axis] > 0) == (count % 2 == 0)
                    steep = np.abs(arrive[..., axis])
                    spread = spread * edge_reflects(scene, axis, high, steep)
            arrive = arrive * flip
            cosine = (arrive * points.normal).sum(axis=-1)
            foot = np.maximum(-arrive[..., 2], 0) * (cosine > 0)
            received = np.stack([np.maximum(cosine, 0), foot], axis=-1)
            local = to_face(depart, np.full(len(target), face))
            for node in range(phi.shape[1]):
                emission = emissions[fiber, node, light]
                sent = (
                    embedded_intensity(emission, local, lamps[fiber].profile)
                    if embedded
                    else beam_intensity(scene, emission, local, face, lamps[fiber].profile)
                    if beam
                    else glow_intensity(emission, local)
                )
                value = np.where(factor > 0, sent * spread * factor, 0.0)
                result[fiber, node] += value[:, None] * received
    return result


def few(scene: Scene) -> Scene:
    """The same sensor with three fibers, one per edge."""
    fibers = unchecked(scene.fibers, {"left": 1, "tip": 1, "right": 1})
    return with_parts(scene, fibers=fibers)


def thin(scene: Scene) -> Scene:
    layer = unchecked(scene.diffuser, {"thickness": 0.5})
    return with_parts(scene, diffuser=layer)


def with_value(scene: Scene, key: str, value: float) -> Scene:
    if (key, value) == ("pad.thickness", 1000.0):
        # From so far away the camera needs a long lens to see any site.
        camera = unchecked(scene.camera, {"field_of_view": np.radians(3.0)})
        scene = with_parts(scene, camera=camera)
    part, name = key.split(".")
    return with_parts(scene, **{part: unchecked(getattr(scene, part), {name: value})})


# Both ends of what the shader reads itself (lengths of the pad as far as sites still fit it).
EXTREMES = [
    ("pad.width", 8.0), ("pad.width", 1000.0), ("pad.length", 20.0), ("pad.length", 1000.0),
    ("pad.thickness", 2.0), ("pad.thickness", 1000.0), ("pad.index", 1.0), ("pad.index", 1.7),
    ("fibers.height", 0.0), ("fibers.height", 4.0), ("fibers.tilt", -np.pi / 3),
    ("fibers.tilt", np.pi / 3), ("indenter.slope", np.pi / 180), ("indenter.slope", np.pi / 2.25),
]  # fmt: skip
BARE_EXTREMES = [
    ("fibers.sigma_v", np.radians(0.1)), ("fibers.sigma_v", np.radians(89.0)),
    ("fibers.diameter", 0.05), ("fibers.gap", 10.0), ("pad.index", 1.0), ("pad.index", 1.7),
]  # fmt: skip
SCENES = (
    {
        "diffuser": few,
        "bare": lambda scene: with_parts(few(scene), diffuser=None),
        "thin diffuser": lambda scene: few(thin(scene)),
    }
    | {
        case: lambda scene, case=case: scene_of_case(case)
        for case in (
            "below",
            "rows of their own",
            "base",
            "beside a corner",
            "mirror walls bent 45",
            "cast in",
            "cast in bent 45",
        )
        + PAINTED
    }
    | {
        f"{'bare, ' if bare else ''}{key} {value:.3g}": lambda scene, c=(bare, key, value): (
            with_value(with_parts(few(scene), **({"diffuser": None} if c[0] else {})), c[1], c[2])
        )
        for bare, cases in ((False, EXTREMES), (True, BARE_EXTREMES))
        for key, value in cases
    }
)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("slab")


@pytest.mark.parametrize("name", SCENES)
def test_the_shader_draws_what_float64_numpy_computes(
    name: str, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The numbers do not matter here, only that both sides use the same ones.
    monkeypatch.setattr("render.preview.lights.RAYS", 3_000)
    scene = SCENES[name](load_scene("finger20"))
    phi = np.array([[0.0, 1.3], [0.7, 2.9], [np.pi / 2, np.pi]])[: scene.lamp_count]
    with Preview(scene, cache=cache) as preview:
        lights, points = point_lights(scene, cache), shading_points(scene)
        # Images of images are those of a pad that never bends.
        bends = (0.0, 1e-6, np.pi / 4, np.pi / 2, np.pi)[: 5 if any(scene.bending.angles) else 2]
        for bend in bends:
            seen = slice(None, points.first_edge if bend > 0.1 else None)
            drawn = preview.direct_irradiance(phi, bend)[:, :, seen]
            with np.errstate(all="ignore"):
                exact = irradiance(scene, lights, points, phi, bend)[:, :, seen]
            assert np.isfinite(drawn).all()
            # A patch of the edge can hold a light: float64 divides by 0 there, the shader does not.
            apart = np.isfinite(exact)
            exact = np.where(apart, exact, 0.0)
            error = np.abs(drawn - exact)
            allowed = RELATIVE * exact + ABSOLUTE * exact.max(axis=2, keepdims=True)
            off = (error > allowed) & apart
            allowed_off = (
                (AT_BORDERS if "BEAM" in lights.defines else 0.0) if name in PLAIN else FEW
            )
            assert off.mean() <= allowed_off, f"{bend}: {off.mean():.2%}"
            lit = apart & (exact > 1e-3 * exact.max())
            assert np.median(error[lit] / exact[lit]) < (1 if name in PLAIN else 50) * MEDIAN
        mine = preview.direct_irradiance(phi, bends[-2])
    with Preview(scene, backend="egl", cache=cache) as other:
        np.testing.assert_allclose(
            other.direct_irradiance(phi, bends[-2]), mine, rtol=1e-3, atol=1e-6 * mine.max()
        )
