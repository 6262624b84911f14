"""Naming faults from a sweep: every fiber alone, so every fiber is judged for itself.

Bayes' rule over explicit hypotheses. With T the predicted light of a fiber's sites, b its relative
power, d its turn and P a permutation of its colors, a site's color is
``gain * P(power) * b * T(d)``, with Gaussian errors of noise and model; a record of the healthy rig
takes the model's error out at d = 0, from where it comes back with d. The evidence of a state is
the mean likelihood over the b, d and P that it allows.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from hw.check.diagnosis import Diagnosis, FiberDiagnosis, FiberState
from hw.check.power_prior import PowerFits, around_one, between
from hw.check.prediction import PadPrediction
from hw.check.rig_tolerances import DEAD_BELOW, DIM_BELOW, MAX_POWER, MIN_TURN, TURNS, RigTolerances
from hw.errors import CaptureError
from render.arrays import Array

PERMUTATIONS = [p for p in itertools.permutations(range(3)) if p != (0, 1, 2)]
FAULT_PRIOR = {
    FiberState.DEAD: 0.25,
    FiberState.DIM: 0.25,
    FiberState.SWAPPED: 0.2,
    FiberState.MOVED: 0.28,
}
"""How faults are shared among their kinds; what is left is `State.UNCLEAR`."""
UNCLEAR_SPREAD = 0.3
"""Relative spread of single sites under `State.UNCLEAR`: dirt, bubbles, loose parts."""
_STEPS = np.gradient(TURNS)


def check_sweep(
    prediction: PadPrediction,
    colors: Array,
    tolerances: RigTolerances,
    ratio: Array | None = None,
) -> Diagnosis:
    """Return what a sweep says about every fiber.

    Arguments:
        prediction: of the design, at the bend of the sweep.
        colors: ``(fiber, site, 3)`` counts of each fiber alone, linear, dark frame subtracted;
            the camera's gain may be anything, but the same for all.
        tolerances: of a healthy rig.
        ratio: ``(fiber, site)`` measured over predicted light of the healthy rig.

    Raises:
        CaptureError: wrong shape, not finite, or all dark.
    """
    fibers, sites = prediction.table.shape[0], prediction.table.shape[2]
    if colors.shape != (fibers, sites, 3) or not np.isfinite(colors).all():
        raise CaptureError(
            f"the sweep has colors of shape {colors.shape}, allowed: finite, ({fibers}, {sites}, "
            "3); capture one image for each fiber of the design",
            field="colors",
            value=colors.shape,
        )
    ratio = np.ones((fibers, sites)) if ratio is None else ratio
    gain = channel_gains(prediction.alone * ratio[..., None], colors)
    seen = colors / gain
    # Noise grows where a channel had to be amplified.
    noise = np.broadcast_to(np.asarray(tolerances.noise), (sites,))[:, None] / gain
    expected = prediction.alone * ratio[..., None]
    diagnoses = []
    turned = prediction.unit(np.clip(prediction.phi[:, None] + TURNS, 0.0, np.pi))
    for fiber in range(fibers):
        power = prediction.power[fiber]
        if not power.any():
            diagnoses.append(FiberDiagnosis(fiber, FiberState.OFF, 1.0))
            continue
        light = turned[fiber] * ratio[fiber]
        reachable = np.abs(prediction.phi[fiber] + TURNS - np.pi / 2) <= np.pi / 2
        diagnoses.append(
            _judged(_Fiber(fiber, seen[fiber], light, reachable, power, noise), tolerances)
        )
    lit = prediction.power.any(axis=1)
    error = float(np.sqrt(np.mean((seen[lit] - expected[lit]) ** 2)))
    return Diagnosis(tuple(diagnoses), prediction.score, error, prediction.domain_excess)


def channel_gains(expected: Array, colors: Array) -> Array:
    """Return captured over expected light per channel ``(3,)``: medians over fibers.

    Single faulty fibers do not move a median. A channel that no fiber uses gets the mean of the
    others.

    Arguments:
        expected: ``(fiber, site, 3)``.
        colors: ``(fiber, site, 3)``.

    Raises:
        CaptureError: no light in any channel.
    """
    wanted, got = expected.sum(axis=1), colors.sum(axis=1)
    gains = np.full(3, np.nan)
    for channel in range(3):
        used = wanted[:, channel] > 0.05 * wanted.max()
        if used.any():
            gains[channel] = np.median(got[used, channel] / wanted[used, channel])
    found = gains[np.isfinite(gains) & (gains > 0)]
    if not len(found):
        raise CaptureError(
            "the sweep is dark: switch the LEDs on, take the lens cap off, or raise the exposure",
            field="colors",
        )
    # A channel of which most fibers are dead must not divide by nothing.
    return np.where(np.isfinite(gains) & (gains > 0.1 * found.max()), gains, found.mean())


@dataclass(frozen=True, eq=False)
class _Fiber:
    """One fiber: ``seen`` ``(site, 3)``, ``light`` ``(turn, site)``, ``noise`` ``(site, 3)``."""

    index: int
    seen: Array
    light: Array
    reachable: Array
    power: Array
    noise: Array

    def fits(self, light: Array, power: Array, model: Array) -> PowerFits:
        """Return how well ``light`` ``(n, site)`` of ``power`` ``(n, 3)`` explains what was seen.

        The model's relative error, ``(n,)``, goes with the light that is there.
        """
        expected = light[:, :, None] * power[:, None, :]
        variance = self.noise**2 + (model[:, None, None] * np.maximum(self.seen, 0.0)) ** 2
        square = np.einsum("nsc,nsc->n", 1 / variance, expected**2)
        best = np.einsum("nsc,nsc->n", self.seen / variance, expected) / square
        rest = np.einsum("sc,nsc->n", self.seen**2, 1 / variance) - best**2 * square
        constant = -0.5 * np.sum(np.log(variance), axis=(1, 2))
        return PowerFits(best, 1 / np.sqrt(square), constant - 0.5 * rest)


def _judged(fiber: _Fiber, tolerances: RigTolerances) -> FiberDiagnosis:
    power, middle = fiber.power[None], len(TURNS) // 2
    straight = fiber.light[middle : middle + 1]
    turned = fiber.fits(
        fiber.light, np.repeat(power, len(TURNS), 0), tolerances.model_when_turned(TURNS)
    )
    permuted = fiber.power[np.array(PERMUTATIONS)]
    permuted = permuted[np.abs(permuted - fiber.power).max(axis=1) > 0.2 * fiber.power.max()]
    unclear = fiber.fits(straight, power, np.array([UNCLEAR_SPREAD]))
    weight = _STEPS * fiber.reachable
    small = weight * np.exp(-0.5 * (TURNS / tolerances.turn) ** 2)
    large = weight * (np.abs(TURNS) >= MIN_TURN)
    usual, loose = around_one(tolerances.power), around_one(2 * tolerances.power)
    evidence = {
        FiberState.OK: _mean(turned.evidence(usual), small),
        FiberState.DEAD: _mean(turned.evidence(between(0.0, DEAD_BELOW)), small),
        FiberState.DIM: _mean(turned.evidence(between(DEAD_BELOW, DIM_BELOW)), small),
        FiberState.MOVED: _mean(turned.evidence(loose), large),
        FiberState.UNCLEAR: float(unclear.evidence(between(0.0, MAX_POWER))[0]),
    }
    if len(permuted):
        swapped = fiber.fits(
            np.repeat(straight, len(permuted), 0),
            permuted,
            np.full(len(permuted), tolerances.model),
        )
        evidence[FiberState.SWAPPED] = _mean(swapped.evidence(loose), np.ones(len(permuted)))
    shares = {**FAULT_PRIOR, FiberState.UNCLEAR: 1 - sum(FAULT_PRIOR.values())}
    log_posterior = {
        state: value
        + np.log(
            1 - tolerances.fault if state is FiberState.OK else tolerances.fault * shares[state]
        )
        for state, value in evidence.items()
    }
    top = max(log_posterior.values())
    weights = {state: float(np.exp(value - top)) for state, value in log_posterior.items()}
    total = sum(weights.values())
    posterior = {state: weight / total for state, weight in weights.items()}
    return _named(fiber, posterior, turned, tolerances)


def _named(
    fiber: _Fiber, posterior: dict[FiberState, float], turned: PowerFits, tolerances: RigTolerances
) -> FiberDiagnosis:
    faulty = 1 - posterior[FiberState.OK]
    if faulty <= tolerances.alarm:
        state, confidence = FiberState.OK, posterior[FiberState.OK]
    else:
        state = max((s for s in posterior if s is not FiberState.OK), key=lambda s: posterior[s])
        confidence = posterior[state]
    if state in (FiberState.SWAPPED, FiberState.UNCLEAR, FiberState.DEAD):
        return FiberDiagnosis(fiber.index, state, confidence)
    turn = len(TURNS) // 2
    if state is FiberState.MOVED:
        # Errors that grow with the turn would draw the best fit towards small ones.
        power = np.repeat(fiber.power[None], len(TURNS), 0)
        turned = fiber.fits(fiber.light, power, np.full(len(TURNS), tolerances.model))
        turn = int(np.argmax(np.where(fiber.reachable, turned.likelihood, -np.inf)))
    power_found, angle = float(turned.best[turn]), float(TURNS[turn])
    detail = {
        FiberState.DIM: f"about {100 * power_found:.0f} % of its power",
        FiberState.MOVED: f"about {np.degrees(angle):+.0f} deg",
    }.get(state, "")
    return FiberDiagnosis(fiber.index, state, confidence, power_found, angle, detail)


def _mean(evidence: Array, weights: Array) -> float:
    """Return the log of the mean of likelihoods, from their logs."""
    used = weights > 0
    if not used.any():
        return -np.inf
    return float(np.logaddexp.reduce(evidence[used] + np.log(weights[used] / weights[used].sum())))
