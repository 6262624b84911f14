"""Refitting the surrogate to a few new renders: a Bayesian linear correction in log T.

The new renders are of designs that a search proposed. They are few and noisy, so the model is not
trained anew. Its residual gets a linear correction in the network's own inputs times the basis of
the facet normal, ``r(cell) = sum_ih B_ih x_i(cell) h_h(normal)``, with independent normal priors
``B_ih ~ N(0, tau^2)``: Bayesian linear regression, whose posterior ``N(mean, covariance)`` is eq.
(2.8) of Rasmussen and Williams (2006).

tau is found by cross-validation (Stone 1974), because cells of one render share their light paths,
and an evidence that takes their noise as independent finds trends in it. The correction by one half
of the replicates is held against the other half: it takes the squared error of a replicate r from
``sum w rho_r^2`` to ``sum w (rho_r - e)^2``, with rho the render's relative deviation from the
surrogate and ``e = exp(r) - 1``. The gain, ``sum w e (2 rho_r - e)``, is linear in the render, so
its mean over replicates is free of bias and its standard error holds whatever cells share. Where
the largest mean gain is not above 0 by Student's t, the correction is refused: renders that do not
bear it out change nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from render.arrays import Array
from render.errors import TableError
from render.scene import Scene
from render.transport import TransportTable
from surrogate.model.lamp_copies import copied, joined_channels, split_channels
from surrogate.model.preview_grid import PreviewGrid

CELLS = 40_000
"""Cells that are treated at once: some 70 MB of products."""
TAUS = (3e-4, 1e-3, 2e-3, 4e-3, 8e-3, 1.6e-2, 3.2e-2)
"""Prior standard deviations of a coefficient that are tried."""
SUPPORT = 0.99
"""Confidence at which renders must bear a correction out, one-sided."""


@dataclass(frozen=True, eq=False)
class NewRenders:
    """Renders of some designs by one run, beside the surrogate's prediction of them.

    Arguments:
        phi: ``(design, fiber)`` rad; bends: ``(bend,)`` rad.
        replicates: ``(replicate, design, fiber, bend, site, normal)``; the normals are the facets,
            then the untouched pad.
        predicted: the surrogate's transport, without the axis ``replicate``.
        copies: of every lamp among the fibers, see `surrogate.model.lamp_copies`.

    Where the skin's albedo depends on the channel, ``replicates`` and ``predicted`` have one more
    axis ``channel``, until ``split`` makes copies of the lamps.
    """

    phi: Array
    bends: Array
    replicates: Array
    predicted: Array
    copies: int = 1

    def split(self, scene: Scene) -> NewRenders:
        """Return the renders without an axis of channels."""
        if not scene.by_channel:
            return self
        replicates, predicted = (
            np.moveaxis(split_channels(scene, np.moveaxis(values, axis, 0)), 0, axis)
            for values, axis in ((self.replicates, 2), (self.predicted, 1))
        )
        phi = copied(scene, self.phi, axis=1)
        return NewRenders(phi, self.bends, replicates, predicted, len(scene.albedos))


@dataclass(frozen=True, eq=False)
class ResidualCorrection:
    """The posterior of the linear correction.

    Arguments:
        mean: ``(21 * 10,)`` coefficients B; covariance: of them.
        tau: prior standard deviation that the renders chose; 0 where they bear no correction out.
    """

    mean: Array
    covariance: Array
    tau: float


class Refitter:
    """Fits corrections and applies them to tables of the surrogate; see the module."""

    def __init__(self, scene: Scene, grid: PreviewGrid) -> None:
        """Keep what turns directions and bends into inputs and basis functions."""
        # Torch takes seconds to import, and `NewRenders` are made without a refit too.
        from surrogate.training.dataset import preview_checker

        self._scene, self._checker = scene, preview_checker(scene, grid)

    def features(self, phi: Array, bends: Array) -> tuple[Array, Array]:
        """Return inputs with a leading 1 ``(row, 21)`` and basis ``(row, 10, normal)``, float64.

        Rows run over ``(design, fiber, bend, site)`` for ``phi`` ``(design, fiber)`` rad.
        """
        from surrogate.training.dataset import cell_features

        x, basis, _ = cell_features(self._checker, phi, bends)
        rows = x.double().numpy()
        return np.concatenate([np.ones((len(rows), 1)), rows], axis=1), basis.double().numpy()

    def fit(self, runs: Sequence[NewRenders]) -> ResidualCorrection:
        """Return the correction by all ``runs``, or none where held-out halves do not bear it out.

        Designs of one run share their light paths, so together they count as one render of each
        cell. The overall scale of every image is a nuisance with the standard deviation that its
        replicates show.

        Raises:
            TableError: a cell of the renders or of the prediction is not a number.
        """
        runs = [run.split(self._scene) for run in runs]
        rows = [self.features(run.phi, run.bends) for run in runs]
        gains: list[Array] = []  # (tau, replicate) by run and half
        for first in (0, 1):
            fitted, held = (
                [_replicates(run, slice(start, None, 2)) for run in runs]
                for start in (first, 1 - first)
            )
            means = np.stack([mean for mean, _ in _posteriors(fitted, rows, TAUS)])
            gains += [
                _held_out_gains(one, other, *row, means)
                for one, other, row in zip(fitted, held, rows, strict=True)
            ]
        mean = np.sum([gain.mean(axis=1) for gain in gains], axis=0)
        variance = np.sum([g.var(axis=1, ddof=1) / g.shape[1] for g in gains], axis=0)
        best = int(np.argmax(mean))
        free = sum(gain.shape[1] - 1 for gain in gains)
        if not mean[best] > stdtrit(free, SUPPORT) * np.sqrt(variance[best]):
            size = means.shape[1]
            return ResidualCorrection(np.zeros(size), np.zeros((size, size)), 0.0)
        ((whole, covariance),) = _posteriors(runs, rows, TAUS[best : best + 1])
        return ResidualCorrection(whole, covariance, TAUS[best])

    def apply(self, correction: ResidualCorrection, table: TransportTable) -> TransportTable:
        """Return ``table`` of the surrogate with the correction; its errors shrink where it knows.

        ``T' = T exp(r)``; the standard error of a cell shrinks by the ratio of posterior to prior
        standard deviation of r.
        """
        if correction.tau == 0.0:
            return table
        if table.background is None:
            raise TableError("the table to be corrected has no background", field="background")
        _, _, bends, sites, facets = table.T.shape[:5]
        fibers = self._scene.lamp_count * len(self._scene.albedos)
        per_node = fibers * bends * sites
        logs, shrinks = [], []
        batch = max(1, CELLS // (per_node * (facets + 1)))
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
        factor = joined_channels(self._scene, np.exp(np.concatenate(logs)).swapaxes(0, 1))
        shrink = joined_channels(self._scene, np.concatenate(shrinks).swapaxes(0, 1))
        facet, pad = np.s_[:, :, :, :, :-1], np.s_[:, :, :, :, -1]
        return replace(
            table,
            T=table.T * factor[facet],
            se=table.se * factor[facet] * shrink[facet],
            background=table.background * factor[pad],
        )


def _replicates(run: NewRenders, part: slice) -> NewRenders:
    """Return the run with some of its replicates."""
    return replace(run, replicates=run.replicates[part])


def _ratio(run: NewRenders, rows: int) -> Array:
    """Return the relative deviation of every replicate from the prediction, ``(R, row, normal)``.

    Raises:
        TableError: a cell of the renders or of the prediction is not a number.
    """
    if not (np.isfinite(run.replicates).all() and np.isfinite(run.predicted).all()):
        raise TableError(
            "renders or predictions to refit with are not finite: the surrogate cannot be "
            "refitted to cells that nobody has seen",
            field="T",
        )
    return np.asarray((run.replicates / run.predicted).reshape(len(run.replicates), rows, -1) - 1.0)


def _weights(run: NewRenders, x: Array) -> Array:
    """Return the weight ``w`` of every cell, ``(row, normal)``.

    Designs of a run, and copies of a lamp, share light paths: they count as one.
    """
    from surrogate.training.dataset import NOISE_FLOOR, smooth_noise

    error = run.replicates.std(axis=0, ddof=1) / np.sqrt(len(run.replicates))
    noise = smooth_noise(run.replicates.mean(axis=0), error, x[:, 1:])
    return np.asarray(1.0 / (len(run.phi) * run.copies * (noise**2 + NOISE_FLOOR**2)))


def _posteriors(
    runs: Sequence[NewRenders], rows: Sequence[tuple[Array, Array]], taus: Sequence[float]
) -> list[tuple[Array, Array]]:
    """Return mean and covariance of the coefficients under every prior of ``taus``.

    ``rows`` has inputs and basis of every run, see ``Refitter.features``.
    """
    blocks = [_normal_equations(run, *row) for run, row in zip(runs, rows, strict=True)]
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
    found = []
    for tau in taus:
        precision[:inputs] = 1.0 / tau**2
        covariance = np.asarray(np.linalg.inv(gram + np.diag(precision)), dtype=np.float64)
        found.append(((covariance @ right)[:inputs], covariance[:inputs, :inputs]))
    return found


def _normal_equations(run: NewRenders, x: Array, basis: Array) -> _NormalEquations:
    ratio, weight = _ratio(run, len(x)).mean(axis=0), _weights(run, x)
    # Scale of the pressed and of the untouched pad at every bend.
    pads = 2 * len(run.bends)
    whole = (
        run.replicates[..., :-1].sum(axis=(1, 2, 4, 5)),
        run.replicates[..., -1].sum(axis=(1, 2, 4)),
    )
    count = len(run.replicates)
    spreads = [s.std(axis=0, ddof=1) / np.sqrt(count) / s.mean(axis=0) for s in whole]
    prior = np.maximum(np.stack(spreads, axis=1).ravel(), 1e-4)
    sites = run.predicted.shape[3]
    bend = np.arange(len(x)) // sites % len(run.bends)
    size = x.shape[1] * basis.shape[1] + pads
    normals = basis.shape[2]
    nuisance = np.zeros((len(x), normals, pads))
    untouched = np.arange(normals) == normals - 1
    nuisance[np.arange(len(x))[:, None], np.arange(normals), 2 * bend[:, None] + untouched] = 1
    gram, right = np.zeros((size, size)), np.zeros(size)
    for part in _parts(len(x), normals):
        scales = nuisance[part].reshape(-1, pads)
        columns = np.concatenate([_columns(x[part], basis[part]), scales], axis=1)
        weighted = columns * weight[part].reshape(-1, 1)
        gram += weighted.T @ columns
        right += weighted.T @ ratio[part].ravel()
    return _NormalEquations(gram, right, prior)


def _held_out_gains(
    fitted: NewRenders, held: NewRenders, x: Array, basis: Array, means: Array
) -> Array:
    """Return the gain of every correction ``means`` ``(tau, input)`` on replicates held out.

    ``(tau, replicate)``; the weights are those of the renders that were fitted, so that the gain
    is linear in those that were not.
    """
    ratio, weight = _ratio(held, len(x)), _weights(fitted, x)
    gains = np.zeros((len(means), len(ratio)))
    for part in _parts(len(x), basis.shape[2]):
        step = np.expm1(_columns(x[part], basis[part]) @ means.T)
        lever = weight[part].reshape(-1, 1) * step
        gains += 2.0 * lever.T @ ratio[:, part].reshape(len(ratio), -1).T
        gains -= (lever * step).sum(axis=0)[:, None]
    return gains


def _parts(rows: int, normals: int) -> list[slice]:
    """Return the rows in batches of some `CELLS` cells."""
    size = max(1, CELLS // normals)
    return [slice(start, start + size) for start in range(0, rows, size)]


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
