"""The whole ladder in one script: preview, renders, superposition, score, search.

    python examples/ladder.py [SCENE] [--samples N]

Reads beside the thesis ("Simulation-guided Design for Vision-based Tactile Sensing on a Soft Robot
Gripper"); equations are numbered as there. It needs numpy and the public API. It finds what
`tactilux explore --objective score` and `tactilux verify` find of finger20: a baseline of 234 and a
design of 273 counts, in three minutes on two cores.

Arrays: transport ``T`` has the axes (fiber f, direction node j, bend b, site p, facet i), radiance
in 1/(mm^2 sr) per unit power of one fiber; ``power`` (fiber, color); counts (bend, site, facet,
color), 0 to 255; directions in rad.
"""

from __future__ import annotations

import argparse
import sys
import time
from functools import partial

import numpy as np

import tactilux

NODES = 11  # Chebyshev nodes of the direction: transport behind a diffuser is smooth in it
GRID = 61  # directions that the search may choose from, 3 deg apart
STARTS = 12  # random colorings that the search begins with


def chebyshev(count: int) -> np.ndarray:
    """Return ``count`` Chebyshev nodes in (0, pi)."""
    return np.pi / 2 * (1 - np.cos(np.pi * (np.arange(count) + 0.5) / count))


def interpolated(T: np.ndarray, nodes: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Return ``T`` ``(f, j, ...)`` at the directions ``phi`` of all fibers, as ``(f, n, ...)``.

    Through the nodes by the polynomial basis T_m (m below the number of nodes).
    """
    at, through = (np.polynomial.chebyshev.chebvander(2 * x / np.pi - 1, len(nodes) - 1)
                   for x in (phi, nodes))  # fmt: skip
    return np.einsum("nj,fj...->fn...", at @ np.linalg.inv(through), T)


# -- light adds up, and is exposed (thesis 4.3.1) --------------------------------------------------


def counts_of(T: np.ndarray, power: np.ndarray, exposure: float) -> np.ndarray:
    """Return counts ``(..., b, p, i, color)`` of ``T`` ``(f, b, p, i)`` and ``power``."""
    light = np.einsum("fbpi,...fc->...bpic", T, power)
    return np.minimum(exposure * light, 255.0)


# -- how well colors tell normals apart (eqs. 4.6 and 4.7) -----------------------------------------


def terms(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return M_theta and M_phi ``(..., b, p)``: mean minus deviation over the facets."""
    length = np.linalg.norm(counts, axis=-1)
    direction = counts / np.maximum(length, 1e-300)[..., None]
    step = np.linalg.norm(direction - np.roll(direction, -1, axis=-2), axis=-1)
    return length.mean(-1) - length.std(-1), step.mean(-1) - step.std(-1)


def score_of(counts: np.ndarray, lam: float) -> np.ndarray:
    """Return S: the mean of M, less its spreads over sites and over bends."""
    theta, phi = terms(counts)
    M = theta + lam * phi
    return M.mean((-1, -2)) - M.mean(-2).std(-1) - M.mean(-1).std(-1)


def settings_of(T: np.ndarray, power: np.ndarray) -> tuple[float, float]:
    """Return exposure and lambda, fixed by the baseline for all designs of the scene.

    Its 99.5th percentile at the first bend has 230 counts; both terms of M weigh the same.
    """
    exposure = 230.0 / np.percentile(np.einsum("fpi,fc->pic", T[:, 0], power), 99.5)
    theta, phi = terms(counts_of(T, power, exposure))
    return exposure, theta.mean() / phi.mean()


# -- search: colors by exchange, directions one at a time ------------------------------------------


def search(T: np.ndarray, colors: np.ndarray, exposure: float, lam: float, seed: int):
    """Return the best directions (indices into ``T``'s second axis) and colors that were found.

    From several colorings: one fiber at a time takes the best of all (direction, color) pairs, and
    pairs of fibers exchange their colors, until nothing moves.
    """
    fibers, directions = T.shape[:2]
    rng, unit = np.random.default_rng(seed), np.eye(3)
    best = (-np.inf, np.zeros(fibers, dtype=int), colors)
    for start in range(STARTS):
        chosen = colors if start == 0 else rng.integers(0, 3, fibers)
        at = np.full(fibers, directions // 2)
        light = np.einsum("fbpi,fc->bpic", T[np.arange(fibers), at], unit[chosen])
        now = score_of(np.minimum(exposure * light, 255.0), lam)
        while True:
            before = now
            for f in rng.permutation(fibers):
                rest = light - T[f, at[f]][..., None] * unit[chosen[f]]
                # Every direction and color of this fiber: (direction, color, b, p, i, channel).
                tried = rest + T[f][:, None, ..., None] * unit[:, None, None, None]
                scores = score_of(np.minimum(exposure * tried, 255.0), lam)
                at[f], chosen[f] = np.unravel_index(scores.argmax(), scores.shape)
                light, now = tried[at[f], chosen[f]], scores.max()
            for f, g in np.stack(np.triu_indices(fibers, 1), axis=1):
                turned = unit[chosen[f]] - unit[chosen[g]]
                change = (T[g, at[g]] - T[f, at[f]])[..., None] * turned
                after = score_of(np.minimum(exposure * (light + change), 255.0), lam)
                if after > now:
                    light, now = light + change, after
                    chosen[f], chosen[g] = chosen[g], chosen[f]
            if now < before + 1e-3:
                break
        if now > best[0]:
            best = (now, at.copy(), chosen.copy())
    return best[1], best[2]


# -- renders decide --------------------------------------------------------------------------------


def jackknifed(statistic, replicates: np.ndarray):
    """Return a statistic of noisy transport, freed of the noise's bias, and its standard error.

    Noise widens every spread. ``replicates`` are independent on the first axis.
    """
    n = len(replicates)
    whole = np.array(statistic(replicates.mean(0)))
    parts = np.array([statistic(part) for part in (replicates.sum(0) - replicates) / (n - 1)])
    spread = np.sqrt((n - 1) / n * np.sum((parts - parts.mean(0)) ** 2, axis=0))
    return n * whole - (n - 1) * parts.mean(0), spread


def progress(state) -> None:
    """Say how long a render still takes."""
    if sys.stderr.isatty():
        print(f"\r  {state.eta_seconds:4.0f} s left ", end="", file=sys.stderr)


def main() -> None:
    """Climb the ladder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default="finger20")
    parser.add_argument("--samples", type=int, default=2000, help="per fiber and facet of a render")
    arguments, began = parser.parse_args(), time.monotonic()

    def say(text: str) -> None:
        print(f"{time.monotonic() - began:6.1f} s  {text}", flush=True)

    scene = tactilux.load_scene(arguments.scene)
    bends, nodes = np.array(scene.bending.angles), chebyshev(NODES)
    baseline = tactilux.baseline_design(scene)

    # The preview: a rasterized approximation of all light paths.
    with tactilux.Preview(scene) as preview:
        T, _ = preview.transport(nodes, bends)
    say(f"preview: transport {T.shape}")

    # The scale of all scores comes from the preview, which has no noise to depend on.
    exposure, lam = settings_of(interpolated(T, nodes, baseline.phi[:1])[:, 0], baseline.power)
    say(f"exposure {exposure:.0f} counts per 1/(mm^2 sr), lambda {lam:.0f}")

    # The reference of the baseline. What the preview has wrong hardly depends on the direction: a
    # factor per fiber, bend, site and facet corrects it for all of them: a surrogate.
    def render(design: tactilux.Design, seed: int):
        return tactilux.render_transport(
            scene, design.phi[:, None], bends, samples=arguments.samples, seeds=(seed,),
            progress=progress,
        )  # fmt: skip

    rendered = render(baseline, seed=1)
    factor = rendered.T / interpolated(T, nodes, baseline.phi[:1])
    T *= factor
    say(f"render: the preview is off by a factor of {factor.mean():.3f} +- {factor.std():.3f}")

    replicates = rendered.replicates[:, :, 0]
    grid = np.linspace(0.0, np.pi, GRID)
    T = interpolated(T, nodes, grid)
    at, colors = search(T, baseline.colors, exposure, lam, seed=0)
    best = tactilux.Design.of_colors(grid[at], colors)
    predicted = score_of(counts_of(T[np.arange(len(at)), at], best.power, exposure), lam)
    say(f"best: predicted S {predicted:.1f}, colors {''.join('RGB'[c] for c in colors)}")

    # Another seed than the one that chose it: a search that picks the best finds noise, too.
    fresh = render(best, seed=2).replicates[:, :, 0]
    for name, design, found in (("baseline", baseline, replicates), ("best", best, fresh)):
        counts = partial(counts_of, power=design.power, exposure=exposure)
        value, error = jackknifed(lambda T, counts=counts: score_of(counts(T), lam), found)
        say(f"{name}: rendered S {value:.1f} +- {error:.1f}")


if __name__ == "__main__":
    main()
