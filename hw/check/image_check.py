"""Naming a fault from one image of all fibers.

The same Bayes' rule as for a sweep, over single faults of any fiber. What a healthy rig may differ
by (powers, turns, the model, the camera's gains) spreads the expected colors; that spread is
Gaussian with a known covariance, in which a fault must stand out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hw.check.diagnosis import Diagnosis, FiberDiagnosis, FiberState
from hw.check.prediction import PadPrediction, shining
from hw.check.rig_tolerances import MIN_TURN, TURNS, RigTolerances
from hw.check.sweep_check import (
    FAULT_PRIOR,
    UNCLEAR_SPREAD,
    per_channel,
    posterior,
    rewired_ratio,
    swapped_powers,
)
from hw.errors import CaptureError
from render.arrays import Array

FAULTY_POWERS = np.concatenate([[0.0], np.linspace(0.05, 0.85, 17)])
"""Relative powers of dead and dim fibers that are tried."""


def check_image(
    prediction: PadPrediction,
    colors: Array,
    tolerances: RigTolerances,
    ratio: Array | None = None,
) -> Diagnosis:
    """Return what one image of all fibers says.

    ``colors`` ``(site, channel)`` are counts at the bend of ``prediction``, linear, dark frame
    subtracted, at any exposure; ``ratio`` ``(fiber, site[, channel])`` is measured over predicted
    light of the healthy rig.

    Raises:
        CaptureError: wrong shape, not finite, or dark.
    """
    sites, channels = prediction.cells[1], prediction.response.shape[1]
    if colors.shape != (sites, channels) or not np.isfinite(colors).all():
        raise CaptureError(
            f"the image has colors of shape {colors.shape}, allowed: finite, ({sites}, {channels})",
            field="colors",
        )
    ratio = per_channel(np.ones(prediction.cells) if ratio is None else ratio)
    power, phi, turns = prediction.seen_power, prediction.phi, prediction.turns
    turned = prediction.tinted(np.clip(phi[:, None] + TURNS, 0.0, np.pi))
    rewired = turned[:, len(TURNS) // 2] * rewired_ratio(prediction, ratio)[0]
    turned = turned * ratio[:, None]
    straight = turned[:, len(TURNS) // 2]
    expected = (straight * power[:, None]).sum(axis=0)
    scale = _scale(expected, colors)
    seen = colors / scale
    error = float(np.sqrt(np.mean((seen - expected) ** 2)))

    whiten = _whitener(prediction, straight, turned, expected, scale, tolerances)
    residual = whiten @ (seen - expected).ravel()
    lit = prediction.lit
    prior = np.log(tolerances.fault)
    weights: dict[tuple[int, FiberState], float] = {}
    for fiber in np.nonzero(lit)[0]:
        response = prediction.response
        permuted = swapped_powers(prediction.power[fiber], response) @ response
        swapped = rewired[fiber] * permuted[:, None]
        faults = _changes(straight[fiber], turned[fiber], power[fiber], swapped, phi[fiber])
        if not turns[fiber]:
            # The model does not say how the light of a lamp that cannot turn would change.
            faults.pop(FiberState.MOVED, None)
        for state, changes in faults.items():
            distance = residual - changes.reshape(len(changes), -1) @ whiten.T
            fits = -0.5 * np.einsum("ni,ni->n", distance, distance)
            share = np.log(FAULT_PRIOR[state] / len(fits))
            weights[int(fiber), state] = float(np.logaddexp.reduce(fits)) + prior + share
    weights[-1, FiberState.OK] = -0.5 * float(residual @ residual)
    weights[-1, FiberState.UNCLEAR] = _unclear(residual, whiten, expected) + prior
    found = _diagnoses(posterior(weights), lit, tolerances)
    return Diagnosis(found, prediction.score, error, prediction.domain_excess)


def _scale(expected: Array, colors: Array) -> float:
    """Return the camera's overall gain: the median over what is bright enough to tell."""
    bright = expected > 0.1 * expected.max()
    scale = float(np.median(colors[bright] / expected[bright]))
    if not scale > 0:
        raise CaptureError(
            "the image is dark: switch the LEDs on, take the lens cap off, or raise the exposure",
            field="colors",
        )
    return scale


def _whitener(
    prediction: PadPrediction,
    straight: Array,
    turned: Array,
    expected: Array,
    scale: float,
    tolerances: RigTolerances,
) -> Array:
    """Return the matrix that makes a healthy rig's residuals unit normal.

    It is ``(site * channel, site * channel)``.
    """
    power, middle = prediction.seen_power, len(TURNS) // 2
    step = TURNS[middle + 1] - TURNS[middle - 1]
    slope = (turned[:, middle + 1] - turned[:, middle - 1]) / step
    alone = straight * power[:, None]
    causes = [
        tolerances.power * alone.reshape(len(power), -1),
        tolerances.turn * (slope * power[:, None]).reshape(len(power), -1),
    ]
    causes += [
        (tolerances.gain * expected * only).reshape(1, -1) for only in np.eye(expected.shape[1])
    ]
    # The overall gain was matched with a median; it is free.
    causes.append(0.1 * expected.reshape(1, -1))
    spread = np.concatenate(causes)
    noise = tolerances.site_noise / scale
    # Channels that see the same LED share the model's error of a site.
    channels = prediction.own.sum(axis=1) / np.maximum(shining(prediction.power).sum(axis=1), 1)
    wide = alone * np.sqrt(np.maximum(channels, 1.0))[:, None, None]
    single = noise**2 + tolerances.model**2 * np.einsum("fsc,fsc->sc", wide, wide)
    covariance = spread.T @ spread + np.diag(single.ravel())
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def _changes(
    straight: Array, turned: Array, power: Array, swapped: Array, phi: float
) -> dict[FiberState, Array]:
    """Return what each fault of one fiber adds to the image, ``(n, site, channel)`` each.

    ``straight`` is ``(site, channel)``, ``turned`` ``(turn, site, channel)``; ``swapped`` ``(n,
    site, channel)`` is what it looks like with swapped colors.
    """
    own = straight * power
    reachable = (np.abs(phi + TURNS - np.pi / 2) <= np.pi / 2) & (np.abs(TURNS) >= MIN_TURN)
    found = {
        FiberState.DEAD: -own[None],
        FiberState.DIM: (FAULTY_POWERS[1:] - 1)[:, None, None] * own,
        FiberState.MOVED: (turned[reachable] - straight) * power,
        FiberState.SWAPPED: swapped - own,
    }
    return {state: changes for state, changes in found.items() if len(changes)}


def _unclear(residual: Array, whiten: Array, expected: Array) -> float:
    """Return the log evidence of a wide spread of every site's color, against that of the model.

    The likelihoods above leave out the common factor of the whitening.
    """
    wide = whiten @ np.diag((UNCLEAR_SPREAD * expected.ravel()) ** 2) @ whiten.T
    covariance = np.eye(len(residual)) + wide
    log_det = np.linalg.slogdet(covariance).logabsdet
    return float(-0.5 * residual @ np.linalg.solve(covariance, residual) - 0.5 * log_det)


def _diagnoses(
    posterior: dict[tuple[int, FiberState], float],
    lit: NDArray[np.bool_],
    tolerances: RigTolerances,
) -> tuple[FiberDiagnosis, ...]:
    """Return one diagnosis per fiber; at most one is at fault, all are unclear if none explains."""
    healthy, unclear = posterior[-1, FiberState.OK], posterior[-1, FiberState.UNCLEAR]
    alarm = 1 - healthy > tolerances.alarm
    by_fiber = {
        fiber: sum(p for (index, _), p in posterior.items() if index == fiber)
        for fiber in np.nonzero(lit)[0].tolist()
    }
    worst = max(by_fiber, key=lambda fiber: by_fiber[fiber], default=-1)
    diagnoses = []
    for fiber, on in enumerate(lit):
        if not on:
            diagnoses.append(FiberDiagnosis(fiber, FiberState.OFF, 1.0))
        elif alarm and unclear > by_fiber[worst]:
            diagnoses.append(FiberDiagnosis(fiber, FiberState.UNCLEAR, unclear))
        elif alarm and fiber == worst:
            own = {s: p for (index, s), p in posterior.items() if index == fiber}
            state = max(own, key=lambda s: own[s])
            diagnoses.append(FiberDiagnosis(fiber, state, own[state]))
        else:
            diagnoses.append(FiberDiagnosis(fiber, FiberState.OK, 1 - by_fiber[fiber]))
    return tuple(diagnoses)
