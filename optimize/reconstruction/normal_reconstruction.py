"""Normal reconstruction: how well the rendered colors give the surface normals back, in degrees.

The score S is a stand-in for this (thesis 4.2): a good light makes normal to color one-to-one and
steep. Two readers are tried. The lookup knows the colors of all normals at each site and bend, and
takes the nearest one to the color that it is shown. The regressor is one polynomial for the whole
sensor: it sees color and position, and is not told the bend.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optimize.design import Array, Design
from optimize.scoring import predict_design, student_factor
from render.geometry import flat_sites
from render.scene import Scene
from surrogate.runtime import Checker

HARMONICS = 3
TILTS, AZIMUTHS = 24, 72
"""Grid of normals that the lookup knows."""
SAMPLES = 64
"""Random normals per site and bend, for training and again for testing."""
RIDGE = 1e-6
SEEDS = 8
"""Independent draws of normals and noise behind every figure."""


@dataclass(frozen=True)
class CameraNoise:
    """Noise of one pixel: ``sqrt(read^2 + count 255 / full_well)`` counts, then rounding.

    ``read`` is the read noise's standard deviation in counts, ``full_well`` photoelectrons at 255
    counts.
    """

    read: float = 1.0
    full_well: float = 10_000.0

    def recorded(self, counts: Array, rng: np.random.Generator) -> Array:
        """Return what the camera records of ``counts`` (any shape)."""
        deviation = np.sqrt(self.read**2 + np.clip(counts, 0.0, 255.0) * 255.0 / self.full_well)
        noisy = counts + deviation * rng.standard_normal(counts.shape)
        return np.clip(np.round(noisy), 0.0, 255.0)


@dataclass(frozen=True, eq=False)
class AngleErrors:
    """Angles between true and recovered normals in degrees, ``(bend, site, sample)``."""

    lookup: Array
    regressor: Array


class NormalColors:
    """Colors of any normal within the indenter's cone, from those of its facets.

    With the azimuth a and the part r of the indenter's sine of the tilt, the counts are
    ``c_0 + r^2 (mean - c_0) + sum_k r^k (a_k cos k a + b_k sin k a)``, k = 1 .. 3: harmonics of the
    facets' colors (eq. 4.2 has k = 1; the others are shadows), smooth at the untouched pad c_0.
    """

    def __init__(self, facets: Array, untouched: Array) -> None:
        """Take ``facets`` ``(B, S, K, C)`` and ``untouched`` ``(B, S, C)`` in counts."""
        count = facets.shape[2]
        orders = np.arange(1, min(HARMONICS, (count - 1) // 2) + 1)
        azimuth = 2 * np.pi * np.arange(count) / count
        cosine = np.cos(orders[:, None] * azimuth) * 2 / count
        sine = np.sin(orders[:, None] * azimuth) * 2 / count
        self._orders = orders
        self._flat, self._bowl = untouched, facets.mean(axis=2) - untouched
        self._cos = np.einsum("ok,bskc->bsoc", cosine, facets)
        self._sin = np.einsum("ok,bskc->bsoc", sine, facets)

    def at(self, tilt: Array, azimuth: Array) -> Array:
        """Return counts ``(B, S, n, C)`` for ``tilt`` in [0, 1] and ``azimuth``, ``(B, S, n)``."""
        power = tilt[..., None] ** self._orders
        turns = azimuth[..., None] * self._orders
        waves = np.einsum("bsno,bsoc->bsnc", power * np.cos(turns), self._cos)
        waves += np.einsum("bsno,bsoc->bsnc", power * np.sin(turns), self._sin)
        bowl = tilt[..., None] ** 2 * self._bowl[:, :, None]
        return np.asarray(np.clip(self._flat[:, :, None] + bowl + waves, 0.0, 255.0))


def reconstruct(
    scene: Scene,
    known: tuple[Array, Array],
    shown: tuple[Array, Array],
    noise: CameraNoise,
    seed: int,
) -> AngleErrors:
    """Return the errors of both readers under camera noise.

    Readers learn from ``known``, facets ``(B, S, K, C)`` and untouched pad ``(B, S, C)``; the
    camera sees ``shown``, the same arrays for a perfect calibration, with ``noise``, also in the
    regressor's training. The same ``seed`` shows two designs the same normals.
    """
    learned, true = NormalColors(*known), NormalColors(*shown)
    bends, sites = known[0].shape[:2]
    rng, tilt, azimuth = _drawn(known, seed)
    colors = noise.recorded(true.at(tilt, azimuth), rng)
    slope = np.sin(scene.indenter.slope)
    target = _vectors(slope, tilt, azimuth)
    guess = _look_up(learned, colors, slope)
    other_tilt, other_azimuth = _normals(rng, (bends, sites, SAMPLES))
    train = noise.recorded(learned.at(other_tilt, other_azimuth), rng)
    fitted = _regress(scene, train, _vectors(slope, other_tilt, other_azimuth), colors)
    return AngleErrors(_angle(guess, target), _angle(fitted, target))


@dataclass(frozen=True)
class ErrorComparison:
    """An error of both designs in degrees, with the 95 % interval of their paired difference."""

    baseline: float
    design: float
    difference: float
    interval: tuple[float, float]

    def to_json(self) -> dict[str, object]:
        """Return plain data."""
        return {**vars(self), "interval": list(self.interval)}


def compare_reconstruction(
    scene: Scene,
    known: Sequence[tuple[Array, Array]],
    shown: Sequence[tuple[Array, Array]],
    noise: CameraNoise,
    seeds: Sequence[int],
) -> dict[str, ErrorComparison]:
    """Return mean and 95th percentile of the errors of both readers, by name.

    ``known`` and ``shown`` are those of `reconstruct` for baseline and design; ``seeds`` draw
    normals and noise independently, in common for both.
    """
    rows: dict[str, list[list[float]]] = {}
    for seed in seeds:
        both = [
            reconstruct(scene, learned, true, noise, seed)
            for learned, true in zip(known, shown, strict=True)
        ]
        for reader in ("lookup", "regressor"):
            errors = [getattr(angles, reader) for angles in both]
            rows.setdefault(f"{reader}_mean", []).append([float(e.mean()) for e in errors])
            rows.setdefault(f"{reader}_95%", []).append(
                [float(np.quantile(e, 0.95)) for e in errors]
            )
    comparisons = {}
    for name, values in rows.items():
        table = np.array(values)
        gain = table[:, 1] - table[:, 0]
        half_width = student_factor(len(gain)) * float(gain.std(ddof=1)) / len(gain) ** 0.5
        mean = float(gain.mean())
        first, second = (float(column.mean()) for column in table.T)
        comparisons[name] = ErrorComparison(
            first, second, mean, (mean - half_width, mean + half_width)
        )
    return comparisons


def predicted_colors(checker: Checker, scene: Scene, design: Design) -> tuple[Array, Array]:
    """Return what the surrogate says of facets and untouched pad, counts, without render noise."""
    output = predict_design(checker, design, np.array(scene.state_axis))
    return output["counts"], output["background"]


def guessing_error(scene: Scene) -> float:
    """Return by how many degrees who always says "untouched" misses the same normals on average."""
    part = (np.arange(1000) + 0.5) / 1000  # of the cone's disk, from its middle
    return float(np.degrees(np.arcsin(np.sin(scene.indenter.slope) * np.sqrt(part))).mean())


def normal_error(
    scene: Scene,
    colors: tuple[Array, Array],
    noise: CameraNoise | None = None,
    seeds: Sequence[int] = range(SEEDS),
) -> float:
    """Return the mean error of the lookup in degrees, shown what it learned from.

    With ``colors`` of the surrogate or of the preview, which have no render noise, this is what
    the light itself is worth; reports say it beside S.

    ``colors`` are facets ``(B, S, K, C)`` and untouched pad ``(B, S, C)`` in counts; ``seeds`` draw
    normals and noise independently.
    """
    noise, learned = noise or CameraNoise(), NormalColors(*colors)
    slope, shown, true = np.sin(scene.indenter.slope), [], []
    for seed in seeds:
        rng, tilt, azimuth = _drawn(colors, seed)
        shown.append(noise.recorded(learned.at(tilt, azimuth), rng))
        true.append(_vectors(slope, tilt, azimuth))
    found = _look_up(learned, np.concatenate(shown, axis=2), slope)
    return float(_angle(found, np.concatenate(true, axis=2)).mean())


def _drawn(colors: tuple[Array, Array], seed: int) -> tuple[np.random.Generator, Array, Array]:
    """Return random tilts and azimuths ``(B, S, SAMPLES)``, and the generator as it goes on."""
    rng = np.random.default_rng([seed, 9])
    return rng, *_normals(rng, (*colors[0].shape[:2], SAMPLES))


def _normals(rng: np.random.Generator, shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Return tilts and azimuths of random normals, even over the cone's disk."""
    return np.sqrt(rng.uniform(size=shape)), rng.uniform(0.0, 2 * np.pi, shape)


def _vectors(slope: float, tilt: Array, azimuth: Array) -> Array:
    """Return unit normals ``(..., 3)`` towards the camera (`render.geometry.layout`)."""
    x, y = slope * tilt * np.sin(azimuth), slope * tilt * np.cos(azimuth)
    return np.stack([x, y, -np.sqrt(1.0 - x**2 - y**2)], axis=-1)


def _look_up(learned: NormalColors, colors: Array, slope: float) -> Array:
    """Return the normals whose known colors are nearest to ``colors`` ``(B, S, n, C)``."""
    from scipy.spatial import cKDTree

    bends, sites = colors.shape[:2]
    tilt, azimuth = np.meshgrid(
        np.linspace(0.0, 1.0, TILTS),
        2 * np.pi * np.arange(AZIMUTHS) / AZIMUTHS,
        indexing="ij",
    )
    tilt = np.broadcast_to(tilt.ravel(), (bends, sites, tilt.size))
    azimuth = np.broadcast_to(azimuth.ravel(), tilt.shape)
    table, normals = learned.at(tilt, azimuth), _vectors(slope, tilt, azimuth)
    out = np.empty((*colors.shape[:3], 3))
    for bend in range(bends):
        for site in range(sites):
            _, index = cKDTree(table[bend, site]).query(colors[bend, site])
            out[bend, site] = normals[bend, site, index]
    return out


def _regress(scene: Scene, train: Array, normals: Array, colors: Array) -> Array:
    """Return normals of ``colors`` by ridge regression on color (degree 3) times position (2)."""
    where = flat_sites(scene)[:, :2] / [scene.pad.width / 2, scene.pad.length / 2]

    def features(counts: Array) -> Array:
        place = np.broadcast_to(where[None, :, None], (*counts.shape[:3], 2))
        both = _monomials(counts / 255.0, 3)[..., :, None] * _monomials(place, 2)[..., None, :]
        return np.asarray(both.reshape(-1, both.shape[-1] * both.shape[-2]))

    known = features(train)
    scale = np.maximum(known.std(axis=0), 1e-9)
    gram = (known / scale).T @ (known / scale)
    right = (known / scale).T @ normals[..., :2].reshape(-1, 2)
    weights = np.linalg.solve(gram + RIDGE * len(known) * np.eye(len(gram)), right)
    plane = ((features(colors) / scale) @ weights).reshape(*colors.shape[:3], 2)
    length = np.linalg.norm(plane, axis=-1, keepdims=True)
    plane = plane / np.maximum(length, 1.0)
    height = -np.sqrt(np.maximum(1.0 - (plane**2).sum(axis=-1), 0.0))
    return np.concatenate([plane, height[..., None]], axis=-1)


def _monomials(x: Array, degree: int) -> Array:
    """Return all monomials of ``x`` ``(..., n)`` up to ``degree``, the constant first."""
    from itertools import combinations_with_replacement

    terms = [np.ones(x.shape[:-1])]
    for order in range(1, degree + 1):
        for chosen in combinations_with_replacement(range(x.shape[-1]), order):
            terms.append(np.prod(x[..., list(chosen)], axis=-1))
    return np.stack(terms, axis=-1)


def _angle(first: Array, second: Array) -> Array:
    """Return the angle in degrees between unit vectors ``(..., 3)``."""
    half = np.linalg.norm(first - second, axis=-1) / 2
    return np.asarray(np.degrees(2 * np.arcsin(np.minimum(half, 1.0))))
