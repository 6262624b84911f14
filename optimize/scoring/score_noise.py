"""How uncertain a score is: errors of the table, propagated by drawing tables (bootstrap).

The table is redrawn as ``T + se z`` with standard normal ``z`` and a fixed seed, and S is computed
for every draw (parametric bootstrap). Which cells share a ``z`` follows from the table's level:

- ``reference``: every cell and fiber has its own, as for independent Monte Carlo noise; channels
  share it, as they share their light paths. Facets of a site share part of it
  (``render.cells.cell_sampler``), or lamps do (``render.cells.clear.clear_cells``), which
  replicates know and tables do not;
- ``preview``, ``surrogate``: all cells of a fiber share one, as model errors are smooth. That is
  the cautious choice: errors that agree do not average out.

Errors at different direction nodes are taken as independent in both cases.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from optimize.design import Array
from optimize.scoring.confidence import normal_factor
from optimize.scoring.table_scorer import TableScorer
from render.chebyshev import interpolation_weights

DRAWS = 400
TIE_DRAWS = 100
# Numbers held at once while drawing.
_CHUNK = 2_000_000


def score_draws(
    scorer: TableScorer, phi: Array, power: Array, draws: int = DRAWS, seed: int = 0
) -> Array:
    """Return S ``(draw, N)`` of ``power`` ``(N, F, C)`` at ``phi`` ``(F,)`` on redrawn tables.

    All lightings see the same draws, so that differences between them keep only what differs.
    """
    light = scorer.light(phi).reshape(scorer.fibers, -1)
    mixing = np.moveaxis(power, 0, -1).reshape(scorer.fibers, -1)
    rows = []
    for noise in _noise(scorer, phi, len(power), draws, seed):
        drawn = light + noise
        if scorer.table.by_channel:
            tinted = drawn.reshape(*drawn.shape[:2], -1, scorer.channels)
            blocks = np.einsum("dfxc,nfc->dxcn", tinted, power, optimize=True)
        else:
            counts = np.matmul(drawn.swapaxes(1, 2), mixing)
            blocks = counts.reshape(len(noise), light.shape[1], scorer.channels, len(power))
        rows += [scorer.score_block(block) for block in blocks]
    return np.array(rows)


def score_interval(scorer: TableScorer, phi: Array, power: Array) -> tuple[float, float]:
    """Return the 95 % interval of S for ``phi`` ``(F,)`` and ``power`` ``(F, C)``.

    Noise lowers S, because its spreads absorb noise; the bootstrap estimates that bias as
    ``mean(S*) - S``. The interval reaches 1.96 standard deviations beyond both the plain and the
    debiased score, so it covers either reading.
    """
    score = scorer.score(phi, power)
    if not scorer.table.se.any():
        return score, score
    drawn = score_draws(scorer, phi, power[None])[:, 0]
    debiased = 2.0 * score - float(drawn.mean())
    half = normal_factor() * float(drawn.std(ddof=1))
    return min(score, debiased) - half, max(score, debiased) + half


def tied(scorer: TableScorer, phi: Array, power: Array) -> np.ndarray:
    """Return which of ``power`` ``(N, F, C)`` the table's errors cannot tell from the first.

    A lighting ties when its lag behind the first one is within 1.96 standard deviations of their
    difference over common draws; without errors, when both scores agree to rounding.
    """
    scores = np.array([scorer.score(phi, lighting) for lighting in power])
    lag = scores[0] - scores
    rounding = 1e-9 * max(1.0, abs(float(scores[0])))
    if not scorer.table.se.any() or len(power) == 1:
        return np.asarray(lag <= rounding)
    drawn = score_draws(scorer, phi, power, TIE_DRAWS)
    spread = (drawn[:, :1] - drawn).std(axis=0, ddof=1)
    return np.asarray(lag <= rounding + normal_factor() * spread)


def _noise(
    scorer: TableScorer, phi: Array, lightings: int, draws: int, seed: int
) -> Iterator[Array]:
    """Yield errors of the light in counts, ``(some draws, F, B * S * K [* C])``."""
    table, rng = scorer.table, np.random.default_rng(seed)
    weights = interpolation_weights(table.phi, phi)
    variance = np.einsum("fj,fjx->fx", weights**2, table.se.reshape(*weights.shape, -1) ** 2)
    sigma = table.exposure * np.sqrt(variance)
    alike = scorer.channels if table.by_channel else 1
    cells = sigma.shape[1] // alike if table.level == "reference" else 1
    size = max(1, _CHUNK // (sigma.size + scorer.channels * lightings * sigma.shape[1]))
    for start in range(0, draws, size):
        noise = rng.standard_normal((min(size, draws - start), len(sigma), cells))
        yield sigma * (noise.repeat(alike, axis=2) if cells > 1 else noise)
