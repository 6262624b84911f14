"""The analog photon tracer against closed forms, quadrature and Mitsuba's own BSDF."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from tests.oracles.analog_cells import bin_areas
from tests.oracles.analog_tracer import (
    BACK,
    COATING,
    LAMBERTIAN,
    LEFT,
    LOWER,
    MEDIUM,
    MICROFACETS,
    MIRROR,
    OPEN,
    OUTSIDE,
    PAINTED,
    RIGHT,
    UPPER,
    Lamp,
    Pad,
    emit,
    fresnel,
    henyey_greenstein,
    meet_face,
    trace_photons,
    trace_views,
)
from tests.oracles.quadrature import irradiance

pytestmark = pytest.mark.slow

N = 1.41


def block(**changes: object) -> Pad:
    """Return a clear smooth pad of 20 x 24 x 4 mm without pyramids, black coating."""
    plain = Pad(
        low=np.array([-10.0, -12.0, 0.0]),
        high=np.array([10.0, 12.0, 4.0]),
        half_width=10.0,
        half_length=12.0,
        index=N,
        alpha=np.zeros(6),
        paint=np.full(6, OPEN),
        reflectance=np.zeros(6),
        sigma_s=0.0,
        sigma_a=0.0,
        g=0.0,
        albedo=0.0,
        apex=np.zeros((0, 3)),
        normal=np.array([[0.0, 0.0, -1.0]]),
        radius=1.0,
        subdivisions=1,
        pitch=0.5,
        columns=40,
        rows=48,
    )
    return plain._replace(**changes)


def pyramid(faces: int, slope: float, radius: float, *sites: tuple[float, float]) -> dict:
    """Return the fields of pyramids pressed into the block at ``sites``; ``slope`` in rad."""
    azimuth = 2 * np.pi * np.arange(faces) / faces
    sin, down = np.sin(slope), np.full(faces, -np.cos(slope))
    depth = radius * np.cos(np.pi / faces) * np.tan(slope)
    return {
        "apex": np.array([[x, y, 4.0 - depth] for x, y in sites]),
        "normal": np.stack([sin * np.sin(azimuth), sin * np.cos(azimuth), down], axis=-1),
        "radius": radius,
    }


def lamp(
    tilt: float = 0.0, turn: float = 0.0, sigma_v: float = 30.0, radius: float = 0.5, z: float = 2.0
) -> Lamp:
    """Return a lamp 1 mm before the face x = -10; angles in degrees, 0 and 0 straight into it."""
    tilt, turn = np.radians(tilt), np.radians(turn)
    beam = np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)])
    across = np.array([-np.sin(turn), np.cos(turn), 0.0])
    frame = np.ascontiguousarray(np.stack([across, np.cross(beam, across), beam], axis=-1))
    return Lamp(np.array([-11.0, 0.0, z]), frame, radius, np.radians(sigma_v))


def traced(pad: Pad, source: Lamp, count: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    return trace_photons(pad, source, count, seed, len(bin_areas(pad)))


def reflectance(incidence: float, index: float = N) -> float:
    """Return what a face reflects of unpolarized light at ``incidence`` rad, by Fresnel's sines."""
    inside = np.arcsin(np.sin(incidence) / index)
    if incidence == 0.0:
        return float(((index - 1) / (index + 1)) ** 2)
    s = np.sin(incidence - inside) / np.sin(incidence + inside)
    p = np.tan(incidence - inside) / np.tan(incidence + inside)
    return float(0.5 * (s**2 + p**2))


def test_all_power_ends_somewhere_and_the_coating_takes_its_share() -> None:
    pad = block(
        albedo=0.7,
        alpha=np.full(6, 0.2),
        low=np.array([-10.0, -12.0, 0.0]),
        half_width=9.0,
        sigma_s=2.0,
        sigma_a=0.1,
        g=0.5,
        **pyramid(6, 0.5, 0.8, (-3.0, 0.0), (2.0, 4.0)),
    )
    tally, ends = traced(pad, lamp(tilt=10), 200_000)
    assert ends.sum() == pytest.approx(1.0, abs=1e-9)
    assert ends[COATING] == pytest.approx(0.3 * tally.sum(), rel=0.01)
    assert ends[MEDIUM] > 0.01
    assert abs(ends[MICROFACETS]) < 0.05
    assert ends[BACK] == 0.0


def test_smooth_faces_lose_nothing_to_microfacets() -> None:
    assert traced(block(albedo=0.5), lamp(), 50_000)[1][MICROFACETS] == 0.0


def test_what_is_aimed_past_the_pad_never_enters_and_what_hits_its_back_is_lost() -> None:
    _, ends = traced(block(), lamp(tilt=60, sigma_v=0.1, z=3.9), 1000)
    assert ends[OUTSIDE] == pytest.approx(1.0)
    _, ends = traced(block(), lamp(tilt=-30, sigma_v=0.1, z=5.5), 1000)
    assert ends[BACK] == pytest.approx(1.0)


@pytest.mark.parametrize("turn", [0.0, 15.0])
@pytest.mark.parametrize("index", [1.0, N, 1.7])
def test_a_beam_through_the_pad_obeys_fresnel_with_all_its_echoes(
    turn: float, index: float
) -> None:
    count = 200_000
    _, ends = traced(block(index=index), lamp(turn=turn, sigma_v=0.1, radius=0.1), count)
    r = reflectance(np.radians(turn), index)
    expected = {
        RIGHT: (1 - r) / (1 + r),
        OUTSIDE: r,
        LEFT: r * (1 - r) / (1 + r),
    }
    for end, power in expected.items():
        assert ends[end] == pytest.approx(power, abs=4.5 * np.sqrt(power * (1 - power) / count))


def painted(face: int, paint: int, reflectance: float, **changes: object) -> Pad:
    """Return the block with paint on one face."""
    plain = block(**changes)
    plain.paint[face], plain.reflectance[face] = paint, reflectance
    return plain


def test_a_beam_before_a_metal_wall_comes_back_by_its_reflectance() -> None:
    count, metal, r = 200_000, 0.9, reflectance(0.0)
    _, ends = traced(painted(RIGHT, MIRROR, metal), lamp(sigma_v=0.1, radius=0.1), count)
    # Through the face at x = -10: (1 - r) in, metal behind, 1 - r out, r back to the metal.
    back = (1 - r) ** 2 * metal / (1 - metal * r)
    lost = (1 - r) * (1 - metal) / (1 - metal * r)
    for end, power in {LEFT: back, PAINTED: lost, OUTSIDE: r, RIGHT: 0.0}.items():
        assert ends[end] == pytest.approx(power, abs=4.5 * np.sqrt(power / count) + 1e-12)


def test_white_paint_sends_light_by_lamberts_law_and_black_none() -> None:
    count, albedo = 1_000_000, 0.7
    spot = {"index": 1.0, "pitch": 2.0, "columns": 10, "rows": 12}
    source = lamp(sigma_v=0.1, radius=0.01)
    tally, ends = traced(painted(RIGHT, LAMBERTIAN, albedo, **spot), source, count)
    assert ends[PAINTED] == pytest.approx(1 - albedo, abs=4.5 * np.sqrt(0.3 / count))
    # A spot at (10, 0, 2) of radiance albedo / pi per area, onto the plane z = 4.
    nodes, weights = np.polynomial.legendre.leggauss(12)
    power = np.zeros((12, 10))
    for u, wu in zip(nodes, weights, strict=True):
        for v, wv in zip(nodes, weights, strict=True):
            x, y = np.meshgrid(2 * np.arange(10) - 9 + u, 2 * np.arange(12) - 11 + v)
            across = 10 - x
            power += wu * wv * albedo / np.pi * across * 2.0 / (across**2 + y**2 + 4) ** 2
    far = power.ravel() * count > 25
    far &= np.arange(120) % 10 < 8  # where the quadrature has converged
    z = (tally - power.ravel())[far] / np.sqrt(power.ravel()[far] / count)
    assert np.abs(z).max() < 4.5
    # It stands halfway between the coating and the lower face.
    assert tally.sum() == pytest.approx(ends[LOWER], rel=0.01)
    tally, ends = traced(painted(RIGHT, LAMBERTIAN, 0.0, **spot), source, 1000)
    assert ends[PAINTED] == 1.0
    assert tally.sum() == 0.0


def test_painted_faces_take_what_comes_from_outside() -> None:
    _, ends = traced(painted(LEFT, MIRROR, 1.0), lamp(sigma_v=0.1), 1000)
    assert ends[PAINTED] == 1.0


def test_an_absorbing_rim_obeys_beer() -> None:
    _, ends = traced(
        block(index=1.0, half_width=8.0, sigma_a=0.3), lamp(sigma_v=0.1, radius=0.1), 100_000
    )
    assert ends[RIGHT] == pytest.approx(np.exp(-0.3 * 4.0), abs=0.007)
    assert ends[MEDIUM] == pytest.approx(1 - np.exp(-0.3 * 4.0), abs=0.007)


def test_the_upper_face_of_the_rim_lets_light_out_and_the_coating_does_not() -> None:
    wide = block(index=1.0, low=np.array([-14.0, -12.0, 0.0]))
    source = Lamp(np.array([-15.0, 0.0, 2.0]), lamp(tilt=45).frame, 0.1, np.radians(0.1))
    _, ends = traced(wide, source, 1000)
    assert ends[UPPER] == pytest.approx(1.0)
    _, ends = traced(block(index=1.0), lamp(tilt=45, sigma_v=0.1, z=1.0), 1000)
    assert ends[COATING] == pytest.approx(1.0)


def test_a_narrow_beam_lands_where_snell_says() -> None:
    tilt, turn = np.radians(35.0), np.radians(10.0)
    pad = block(pitch=0.05, columns=400, rows=480)
    tally, _ = traced(pad, lamp(tilt=35, turn=10, sigma_v=0.1, radius=0.02, z=1.0), 100_000)
    beam = np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)])
    inside = beam / N
    inside[0] = np.sqrt(1 - inside[1] ** 2 - inside[2] ** 2)
    entry = np.array([-11.0, 0.0, 1.0]) + beam / beam[0]
    landing = entry + inside * (4.0 - entry[2]) / inside[2]
    x = (np.arange(400) + 0.5) * 0.05 - 10
    y = (np.arange(480) + 0.5) * 0.05 - 12
    grid = tally.reshape(480, 400) / tally.sum()
    assert (grid.sum(axis=0) * x).sum() == pytest.approx(landing[0], abs=0.01)
    assert (grid.sum(axis=1) * y).sum() == pytest.approx(landing[1], abs=0.01)
    assert tally.sum() == pytest.approx(1 - reflectance(np.arccos(beam[0])), abs=0.002)


@pytest.mark.parametrize("sigma_v", [10.0, 30.0, 89.0])
def test_without_faces_a_lamp_lights_the_coating_by_its_form_factor(sigma_v: float) -> None:
    pad = block(index=1.0, pitch=2.0, columns=10, rows=12)
    source, count = lamp(tilt=30, turn=20, sigma_v=sigma_v), 1_000_000
    tally, _ = traced(pad, source, count)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    x, y = (2 * (np.arange(n) + 0.5) - n for n in (10, 12))
    power = np.zeros((12, 10))
    for u, wu in zip(nodes, weights, strict=True):
        for v, wv in zip(nodes, weights, strict=True):
            at_x, at_y = np.meshgrid(x + u, y + v)
            point = np.stack([at_x, at_y, np.full_like(at_x, 4.0)], axis=-1)
            power += wu * wv * irradiance(point, np.array([0.0, 0.0, -1.0]), source)
    z = (tally - power.ravel()) / np.sqrt(power.ravel() / count)
    assert tally.sum() == pytest.approx(power.sum(), rel=0.005)
    assert np.abs(z[power.ravel() * count > 25]).max() < 4.5


def test_facets_of_a_pyramid_are_lit_by_their_form_factors() -> None:
    pad = block(index=1.0, subdivisions=3, **pyramid(6, 0.6, 2.0, (-4.0, 1.0)))
    source, count = lamp(tilt=20), 1_000_000
    tally, _ = traced(pad, source, count)
    m, faces = 3, 6
    apex = pad.apex[0]
    azimuth = 2 * np.pi * (np.arange(faces + 1) - 0.5) / faces
    ring = np.stack([2 * np.sin(azimuth), 2 * np.cos(azimuth), np.full(7, 4.0 - apex[2])], axis=-1)
    corner = np.array([-4.0, 1.0, apex[2]])
    area = bin_areas(pad)[: faces * m * m].reshape(faces, m, m)
    for facet in range(faces):
        a, b = ring[facet], ring[facet + 1]
        for i in range(m):
            for j in range(m - i):
                # Of the bin's points those within the facet: half of the square where i + j = 2.
                s = (np.arange(24) + 0.5) / 24
                u, v = np.meshgrid((i + s) / m, (j + s) / m)
                within = u + v < 1
                points = corner + u[within][:, None] * a + v[within][:, None] * b
                power = irradiance(points, pad.normal[facet], source).mean() * area[facet, i, j]
                found = tally[(facet * m + i) * m + j]
                assert found == pytest.approx(
                    power, abs=4.5 * np.sqrt(power / count) + 0.03 * power
                )
    lit = tally[: faces * m * m].reshape(faces, -1).sum(axis=1)
    # Azimuth 3 pi / 2 faces the lamp, and pi / 2 lies in the pyramid's own shadow.
    assert lit[4] + lit[5] > 3 * (lit[1] + lit[2])
    assert lit[1] + lit[2] < 0.3 * lit.max()


def test_bins_of_pyramids_and_of_the_flat_rest_cover_the_coating() -> None:
    pad = block(subdivisions=4, **pyramid(6, 0.6, 2.0, (-4.0, 1.0), (3.3, -5.2)))
    area = bin_areas(pad)
    facets = area[: 2 * 6 * 16].sum()
    base = 2 * 6 * 0.5 * 4.0 * np.sin(np.pi / 3)
    assert facets == pytest.approx(base / np.cos(0.6))
    assert area[2 * 6 * 16 :].sum() == pytest.approx(20 * 24 - base, rel=1e-3)


def directions(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return directions towards -z with density cosine / pi."""
    sin, azimuth = np.sqrt(rng.random(count)), 2 * np.pi * rng.random(count)
    return np.stack([sin * np.cos(azimuth), sin * np.sin(azimuth), -np.sqrt(1 - sin**2)], axis=-1)


def crossings(eta: float, alpha: float, count: int, bins: int) -> np.ndarray:
    """Return the weight that goes through a face from cosine bin to cosine bin, both of sin^2."""
    rng = np.random.Generator(np.random.PCG64(7))
    state = np.array([3], dtype=np.uint64)
    table = np.zeros((bins, bins))
    for d in directions(rng, count):
        coming = min(bins - 1, int(bins * (1 - d[2] ** 2)))
        weight, through = meet_face(state, d, 2, alpha, eta)
        if through and weight > 0:
            table[coming, min(bins - 1, int(bins * (1 - d[2] ** 2)))] += weight / count
    return table


def test_a_rough_face_passes_as_much_one_way_as_the_other_per_index_squared() -> None:
    count = 150_000
    out, back = crossings(N, 0.3, count, 4), crossings(1 / N, 0.3, count, 4).T * N**2
    error = np.sqrt((out + N**2 * back) / count)
    assert out.sum() > 0.8
    assert np.abs((out - back) / np.maximum(error, 1e-5)).max() < 4.5


@pytest.mark.parametrize("eta", [N, 1 / N])
@pytest.mark.parametrize(("alpha", "cosine"), [(0.1, 0.9), (0.1, 0.2), (0.4, 0.5)])
def test_a_rough_face_is_mitsubas_roughdielectric(
    mono: ModuleType, eta: float, alpha: float, cosine: float
) -> None:
    face = mono.load_dict(
        {"type": "roughdielectric", "distribution": "beckmann", "alpha": alpha, "int_ior": N,
         "ext_ior": 1.0}
    )  # fmt: skip
    # Where light of this cosine goes, in bins of the outgoing cosine and azimuth, by quadrature.
    sign = 1.0 if eta > 1 else -1.0
    fine, bins = 600, 12
    z, azimuth = np.meshgrid(
        -1 + 2 * (np.arange(fine) + 0.5) / fine, 2 * np.pi * (np.arange(fine) + 0.5) / fine
    )
    sin = np.sqrt(1 - z**2)
    si = mono.SurfaceInteraction3f()
    si.wi = mono.Vector3f(float(np.sqrt(1 - cosine**2)), 0.0, sign * cosine)
    wo = mono.Vector3f(
        *(a.ravel().astype(np.float32) for a in (sin * np.cos(azimuth), sin * np.sin(azimuth), z))
    )
    context = mono.BSDFContext(mono.TransportMode.Importance)
    value = np.array(face.eval(context, si, wo))[0].reshape(fine, fine) * 4 * np.pi / fine**2
    theirs = value.sum(axis=0).reshape(bins, -1).sum(axis=1)
    count, state = 200_000, np.array([11], dtype=np.uint64)
    ours, squares = np.zeros(bins), np.zeros(bins)
    for _ in range(count):
        d = np.array([-np.sqrt(1 - cosine**2), 0.0, -sign * cosine])
        weight, _ = meet_face(state, d, 2, alpha, eta)
        ours[min(bins - 1, int(bins * (0.5 + 0.5 * d[2])))] += weight / count
        squares[min(bins - 1, int(bins * (0.5 + 0.5 * d[2])))] += weight**2 / count
    error = np.sqrt(squares / count) + 0.003 * theirs + 1e-5
    np.testing.assert_array_less(np.abs(ours - theirs), 4.5 * error)
    assert ours.sum() == pytest.approx(theirs.sum(), rel=0.005)


def test_fresnel_is_the_textbooks_from_either_side() -> None:
    for incidence in (0.0, 0.4, 1.2, 1.5):
        value, inside = fresnel(np.cos(incidence), N)
        assert value == pytest.approx(reflectance(incidence))
        assert fresnel(inside, 1 / N)[0] == pytest.approx(value)
    assert fresnel(0.5, 1 / N)[0] == 1.0


@pytest.mark.parametrize("g", [-0.9, 0.0, 0.75, 0.99])
def test_scattering_has_the_mean_cosine_g_and_keeps_directions_units(g: float) -> None:
    state, before = np.array([5], dtype=np.uint64), np.array([0.6, 0.0, -0.8])
    cosines = []
    for _ in range(40_000):
        d = before.copy()
        henyey_greenstein(state, d, g)
        cosines.append(d @ before)
        assert abs(d @ d - 1) < 1e-12
    assert np.mean(cosines) == pytest.approx(g, abs=0.01)


def test_a_lamp_emits_its_profile_from_its_disk() -> None:
    state, source = np.array([9], dtype=np.uint64), lamp(tilt=20, turn=30, sigma_v=20)
    p, d, cosines, radii = np.zeros(3), np.zeros(3), [], []
    for _ in range(40_000):
        emit(state, source, p, d)
        cosines.append(d @ source.frame[:, 2])
        radii.append(np.linalg.norm(p - source.center))
    theta = np.linspace(0, np.pi / 2, 100_001)
    power = np.exp(-((theta / (2 * source.sigma_v)) ** 2)) * np.cos(theta) * np.sin(theta)
    mean = (power * np.cos(theta)).sum() / power.sum()
    assert np.mean(cosines) == pytest.approx(mean, abs=0.003)
    assert np.mean(np.square(radii)) == pytest.approx(0.5 * source.radius**2, rel=0.02)
    assert max(radii) <= source.radius


def test_a_ray_of_the_camera_brings_what_the_lower_face_passes_to_where_snell_says() -> None:
    pad, count = block(), 20_000
    origin, d = np.array([1.0, -2.0, -15.0]), np.array([0.3, 0.2, 1.0]) / np.sqrt(1.13)
    views = np.zeros((1, len(bin_areas(pad))))
    trace_views(pad, origin, np.tile(d, (count, 1)), np.zeros(count, dtype=np.int64), 1, views)
    at = origin + d * 15.0 / d[2]
    inside = d / N
    at += inside * 4.0 / np.sqrt(1 - inside[0] ** 2 - inside[1] ** 2)
    place = int((at[1] + 12) / 0.5) * 40 + int((at[0] + 10) / 0.5)
    assert views[0].argmax() == place
    assert views.sum() == views[0, place]
    expected = 1 - reflectance(np.arccos(d[2]))
    assert views.sum() / count == pytest.approx(expected, abs=0.006)
