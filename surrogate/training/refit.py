"""Refitting the surrogate to a few new renders: a Bayesian linear correction in log T.

The new renders are of designs that a search proposed. They are few and noisy, so the model is not
trained anew. Its residual gets a linear correction in the network's own inputs times the basis of
the facet normal, ``r(cell) = sum_ih B_ih x_i(cell) h_h(normal)``, with independent normal priors
``B_ih ~ N(0, tau^2)``: Bayesian linear regression, whose posterior ``N(mean, covariance)`` is eq.
(2.8) of Rasmussen and Williams (2006). tau is the prior standard deviation of greatest evidence
(type II maximum likelihood; eq. (3.86) of Bishop 2006), so that renders which agree with the
surrogate within their noise change nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from render.arrays import Array
from render.errors import TableError
from render.scene import Scene
from render.transport import TransportTable
from surrogate.model.preview_grid import PreviewGrid

CELLS = 40_000
"""Cells that are treated at once: some 70 MB of products."""
TAUS = (0.0, 3e-4, 1e-3, 2e-3, 4e-3, 8e-3, 1.6e-2, 3.2e-2)
"""Prior standard deviations of a coefficient that are tried; 0 leaves the surrogate as it is."""


@dataclass(frozen=True, eq=False)
class NewRenders:
    """Renders of some designs by one run, beside the surrogate's prediction of them.

    Arguments:
        phi: ``(design, fiber)`` rad; bends: ``(bend,)`` rad.
        replicates: ``(replicate, design, fiber, bend, site, normal)``; the normals are the facets,
            then the untouched pad.
        predicted: the surrogate's transport, without the axis ``replicate``.
    """

    phi: Array
    bends: Array
    replicates: Array
    predicted: Array


@dataclass(frozen=True, eq=False)
class ResidualCorrection:
    """The posterior of the linear correction.

    Arguments:
        mean: ``(21 * 10,)`` coefficients B; covariance: of them.
        tau: prior standard deviation that the renders chose.
        cells: number of cells that it was fitted to.
    """

    mean: Array
    covariance: Array
    tau: float
    cells: int


class Refitter:
    """Fits corrections and applies them to tables of the surrogate; see the module."""

    def __init__(self, scene: Scene, grid: PreviewGrid) -> None:
        """Keep what turns directions and bends into inputs and basis functions."""
        # Torch takes seconds to import, and `NewRenders` are made without a refit too.
        from surrogate.training.dataset import preview_checker

        self._checker = preview_checker(scene, grid)

    def features(self, phi: Array, bends: Array) -> tuple[Array, Array]:
        """Return inputs with a leading 1 ``(row, 21)`` and basis ``(row, 10, normal)``, float64.

        Rows run over ``(design, fiber, bend, site)`` for ``phi`` ``(design, fiber)`` rad.
        """
        from surrogate.training.dataset import cell_features

        x, basis, _ = cell_features(self._checker, phi, bends)
        rows = x.double().numpy()
        return np.concatenate([np.ones((len(rows), 1)), rows], axis=1), basis.double().numpy()

    def fit(self, runs: Sequence[NewRenders]) -> ResidualCorrection:
        """Return the correction of greatest evidence given all ``runs``.

        Designs of one run share their light paths, so together they count as one render of each
        cell. The overall scale of every image is a nuisance with the standard deviation that its
        replicates show.

        Raises:
            TableError: a cell of the renders or of the prediction is not a number.
        """
        blocks = [self._normal_equations(run) for run in runs]
        inputs = len(blocks[0].right) - len(blocks[0].prior)
        size = inputs + sum(len(block.prior) for block in blocks)
        gram, right = np.zeros((size, size)), np.zeros(size)
        precision, start = np.zeros(size), inputs
        for block in blocks:
            index = np.r_[0:inputs, start : start + len(block.prior)]
            gram[np.ix_(index, index)] += block.gram
            right[index] += block.right
            precision[start : start + len(block.prior)] = 1.0 / block.prior**2
            start += len(block.prior)
        best: tuple[float, float, Array, Array] | None = None
        for tau in TAUS:
            # A coefficient of prior standard deviation 0 is 0: left out, not divided by.
            kept = np.arange(inputs if tau == 0.0 else 0, size)
            prior = np.where(kept < inputs, 1.0 / max(tau, 1e-12) ** 2, precision[kept])
            covariance = np.linalg.inv(gram[np.ix_(kept, kept)] + np.diag(prior))
            mean = covariance @ right[kept]
            evidence = 0.5 * (
                np.log(prior).sum() + np.linalg.slogdet(covariance)[1] + float(right[kept] @ mean)
            )
            if best is None or evidence > best[0]:
                whole, spread = np.zeros(inputs), np.zeros((inputs, inputs))
                if tau > 0.0:
                    whole, spread = mean[:inputs], covariance[:inputs, :inputs]
                best = (float(evidence), tau, whole, spread)
        assert best is not None  # TAUS is not empty
        return ResidualCorrection(best[2], best[3], best[1], sum(block.cells for block in blocks))

    def _normal_equations(self, run: NewRenders) -> _NormalEquations:
        from surrogate.training.dataset import NOISE_FLOOR, smooth_noise

        mean = run.replicates.mean(axis=0)
        if not (np.isfinite(mean).all() and np.isfinite(run.predicted).all()):
            raise TableError(
                "renders or predictions to refit with are not finite: the surrogate cannot be "
                "refitted to cells that nobody has seen",
                field="T",
            )
        count, designs = len(run.replicates), len(run.phi)
        error = run.replicates.std(axis=0, ddof=1) / np.sqrt(count)
        x, basis = self.features(run.phi, run.bends)
        ratio = (mean / run.predicted).reshape(len(x), -1) - 1.0
        noise = smooth_noise(mean, error, x[:, 1:])
        weight = 1.0 / (designs * (noise**2 + NOISE_FLOOR**2))
        # Scale of the pressed and of the untouched pad at every bend.
        pads = 2 * len(run.bends)
        whole = (
            run.replicates[..., :-1].sum(axis=(1, 2, 4, 5)),
            run.replicates[..., -1].sum(axis=(1, 2, 4)),
        )
        spreads = [s.std(axis=0, ddof=1) / np.sqrt(count) / s.mean(axis=0) for s in whole]
        prior = np.maximum(np.stack(spreads, axis=1).ravel(), 1e-4)
        sites = run.predicted.shape[3]
        bend = np.arange(len(x)) // sites % len(run.bends)
        inputs = x.shape[1] * basis.shape[1]
        size = inputs + pads
        normals = basis.shape[2]
        nuisance = np.zeros((len(x), normals, pads))
        untouched = np.arange(normals) == normals - 1
        nuisance[np.arange(len(x))[:, None], np.arange(normals), 2 * bend[:, None] + untouched] = 1
        gram, right = np.zeros((size, size)), np.zeros(size)
        rows = max(1, CELLS // normals)
        for start in range(0, len(x), rows):
            part = slice(start, start + rows)
            scales = nuisance[part].reshape(-1, pads)
            columns = np.concatenate([_columns(x[part], basis[part]), scales], axis=1)
            weighted = columns * weight[part].reshape(-1, 1)
            gram += weighted.T @ columns
            right += weighted.T @ ratio[part].ravel()
        return _NormalEquations(gram, right, prior, ratio.size)

    def apply(self, correction: ResidualCorrection, table: TransportTable) -> TransportTable:
        """Return ``table`` of the surrogate with the correction; its errors shrink where it knows.

        ``T' = T exp(r)``; the standard error of a cell shrinks by the ratio of posterior to prior
        standard deviation of r.
        """
        if correction.tau == 0.0:
            return table
        if table.background is None:
            raise TableError("the table to be corrected has no background", field="background")
        fibers, _, bends, sites, _ = table.T.shape
        per_node = fibers * bends * sites
        logs, shrinks = [], []
        batch = max(1, CELLS // (per_node * (table.T.shape[4] + 1)))
        for start in range(0, len(table.phi), batch):
            nodes = table.phi[start : start + batch]
            x, basis = self.features(np.repeat(nodes[:, None], fibers, axis=1), table.bends)
            columns = _columns(x, basis)
            posterior = ((columns @ correction.covariance) * columns).sum(axis=1)
            prior = correction.tau**2 * (columns**2).sum(axis=1)
            shape = (len(nodes), fibers, bends, sites, basis.shape[2])
            logs.append((columns @ correction.mean).reshape(shape))
            shrinks.append(np.sqrt(np.clip(posterior / prior, 0.0, 1.0)).reshape(shape))
        # (node, fiber, ...) -> (fiber, node, ...)
        factor = np.exp(np.concatenate(logs)).swapaxes(0, 1)
        shrink = np.concatenate(shrinks).swapaxes(0, 1)
        return replace(
            table,
            T=table.T * factor[..., :-1],
            se=table.se * factor[..., :-1] * shrink[..., :-1],
            background=table.background * factor[..., -1],
        )


def _columns(x: Array, basis: Array) -> Array:
    """Return ``(row * normal, 21 * 10)`` products of inputs and basis functions."""
    product = x[:, None, :, None] * basis.transpose(0, 2, 1)[:, :, None, :]
    return np.asarray(product.reshape(-1, x.shape[1] * basis.shape[1]))


@dataclass(frozen=True, eq=False)
class _NormalEquations:
    """Normal equations of one run; ``prior`` are standard deviations of its last unknowns."""

    gram: Array
    right: Array
    prior: Array
    cells: int
