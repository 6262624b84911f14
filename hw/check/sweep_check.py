"""Naming faults from a sweep: every fiber alone, so every fiber is judged for itself.

Bayes' rule over explicit hypotheses. With T the predicted light of a fiber's sites, b its relative
power, d its turn, P a permutation of its colors and R the response of channels to LED colors, a
site's color is ``gain * P(power) R * b * T(d)``, with Gaussian errors of noise and model; a record
of the healthy rig takes the model's error out at d = 0, from where it comes back with d. The
evidence of a state is the mean likelihood over the b, d and P that it allows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hw.camera.led_colors import exchanges, own_channels
from hw.check.camera_response import channel_gains, unmeasured_colors
from hw.check.diagnosis import Diagnosis, FiberDiagnosis, FiberState
from hw.check.prediction import PadPrediction, shining, shone_channels
from hw.check.rig_tolerances import (
    DEAD_BELOW,
    DIM_BELOW,
    MAX_POWER,
    MIN_TURN,
    MODEL,
    TURNS,
    RigTolerances,
)
from hw.errors import CaptureError
from render.arrays import Array

Prior = Callable[[Array], Array]
"""Density of the relative power, ``(...)`` for ``(...)``."""

STEPS = np.linspace(-5.0, 5.0, 21)
"""Where the integrand is evaluated, in standard deviations of the likelihood."""


@dataclass(frozen=True, eq=False)
class PowerFits:
    """Likelihoods that are Gaussian in a fiber's unknown power, one per hypothesis.

    All ``(n,)``: most likely relative power, its standard deviation, log of the likelihood there.
    """

    best: Array
    spread: Array
    likelihood: Array

    def evidence(self, prior: PowerPrior) -> Array:
        """Return the log of the likelihood's mean under ``prior``, ``(n,)``.

        Where the prior is far from the likelihood, the integral starts at the prior's nearest
        power: it is tiny there, but not nothing.
        """
        center = np.clip(self.best, prior.low, prior.high)
        scale = np.minimum(self.spread, prior.high - prior.low)
        power = center[:, None] + STEPS * scale[:, None]
        inside = (power >= prior.low) & (power <= prior.high)
        log_part = (
            np.where(inside, prior.log_density(power), -np.inf)
            - 0.5 * ((power - self.best[:, None]) / self.spread[:, None]) ** 2
        )
        step = (STEPS[1] - STEPS[0]) * scale
        return np.asarray(self.likelihood + np.logaddexp.reduce(log_part, axis=1) + np.log(step))


@dataclass(frozen=True)
class PowerPrior:
    """A prior density of the relative power on ``[low, high]``."""

    low: float
    high: float
    log_density: Prior


def around_one(spread: float) -> PowerPrior:
    """Return the normal density about 1; it is followed to 8 standard deviations."""
    norm = np.log(spread * np.sqrt(2 * np.pi))
    low, high = max(1 - 8 * spread, 0.0), 1 + 8 * spread
    return PowerPrior(low, high, lambda b: -0.5 * ((b - 1) / spread) ** 2 - norm)


def between(low: float, high: float) -> PowerPrior:
    """Return the uniform density."""
    return PowerPrior(low, high, lambda b: np.full(b.shape, -np.log(high - low)))


FAULT_PRIOR = {
    FiberState.DEAD: 0.25,
    FiberState.DIM: 0.25,
    FiberState.SWAPPED: 0.2,
    FiberState.MOVED: 0.28,
}
"""How faults are shared among their kinds; what is left is `State.UNCLEAR`."""
MIN_SEEN_CHANGE = 0.1
"""Change of the light in some channel, relative, from which swapped colors look different."""
LEAK_SPREAD = 0.1
"""Relative spread of what other channels see of LEDs of one color: their spectra differ."""
RESPONSE_SPREAD = 0.15
"""Relative spread of what channels see of LEDs of a color that no fiber of the design has alone."""
UNCLEAR_SPREAD = 0.3
"""Relative spread of single sites under `State.UNCLEAR`: dirt, bubbles, loose parts."""
_STEPS = np.gradient(TURNS)
Key = TypeVar("Key")


def check_sweep(
    prediction: PadPrediction,
    colors: Array,
    tolerances: RigTolerances,
    ratio: Array | None = None,
) -> Diagnosis:
    """Return what a sweep says about every fiber.

    ``colors`` ``(fiber, site, channel)`` are counts of each fiber alone at the bend of
    ``prediction``, linear, dark frame subtracted; the camera's gain may be anything, but the same
    for all. ``ratio`` ``(fiber, site[, channel])`` is measured over predicted light of the healthy
    rig.

    Raises:
        CaptureError: wrong shape, not finite, or all dark.
    """
    fibers, sites = prediction.cells
    channels = prediction.response.shape[1]
    if colors.shape != (fibers, sites, channels) or not np.isfinite(colors).all():
        raise CaptureError(
            f"the sweep has colors of shape {colors.shape}, allowed: finite, ({fibers}, {sites}, "
            f"{channels}); capture one image for each fiber of the design",
            field="colors",
        )
    recorded = ratio is not None
    ratio = per_channel(np.ones((fibers, sites)) if ratio is None else ratio)
    rewired, unknown = rewired_ratio(prediction, ratio)
    gain = channel_gains(
        prediction.alone * ratio, colors, prediction.own, recorded, prediction.one_led
    )
    seen = colors / gain
    # Noise grows where a channel had to be amplified.
    noise = np.broadcast_to(tolerances.site_noise / gain, (sites, channels))
    expected = prediction.alone * ratio
    diagnoses, unmeasured = [], unmeasured_colors(prediction)
    turned = prediction.tinted(np.clip(prediction.phi[:, None] + TURNS, 0.0, np.pi))
    turns = prediction.turns
    for fiber in range(fibers):
        power, response = prediction.power[fiber], prediction.response
        if not power.any():
            diagnoses.append(FiberDiagnosis(fiber, FiberState.OFF, 1.0))
            continue
        light = turned[fiber] * ratio[fiber]
        other = turned[fiber, len(TURNS) // 2] * rewired[fiber]
        reachable = np.abs(prediction.phi[fiber] + TURNS - np.pi / 2) <= np.pi / 2
        if not turns[fiber]:
            reachable = np.ones(len(TURNS), dtype=np.bool_)
        diagnoses.append(
            _judged(
                _Fiber(
                    fiber,
                    seen[fiber],
                    light,
                    bool(turns[fiber]),
                    reachable,
                    power,
                    response,
                    noise,
                    tolerances.power,
                    other,
                    unknown[fiber],
                    unmeasured,
                ),
                tolerances,
            )
        )
    lit = prediction.lit
    error = float(np.sqrt(np.mean((seen[lit] - expected[lit]) ** 2)))
    return Diagnosis(tuple(diagnoses), prediction.score, error, prediction.domain_excess)


def per_channel(ratio: Array) -> Array:
    """Return ratios ``(fiber, site[, channel])`` with an axis of channels, of one for all."""
    return ratio if ratio.ndim == 3 else ratio[..., None]


def rewired_ratio(prediction: PadPrediction, ratio: Array) -> tuple[Array, Array]:
    """Return the ratio of fibers whose LEDs are wired to other colors, and its relative error.

    A ``ratio`` by channel ``(fiber, site, channel)`` holds that of the LEDs a fiber shines with,
    also where other channels see them. Where a channel sees an LED of its own instead, the ratio is
    that of the channels in which the fiber shines, with the error ``(fiber, channel)`` that the
    model has.
    """
    if ratio.shape[-1] == 1:
        return ratio, np.zeros(prediction.seen_power.shape)
    own = prediction.own
    shone = np.einsum("fsc,fc->fs", ratio, own) / np.maximum(own.sum(axis=1), 1)[:, None]
    return np.where(own[:, None], ratio, shone[..., None]), np.where(own, 0.0, MODEL)


@dataclass(frozen=True, eq=False)
class _Fiber:
    """One fiber: ``seen`` and ``noise`` ``(site, channel)``, ``light`` ``(turn, site, channel)``.

    It ``turns`` where light is known to change with its direction; some turns are ``reachable``.
    ``power`` ``(color,)`` is of its LEDs, ``response`` what channels see of these, ``led_spread``
    by how much their powers differ. ``rewired`` ``(site, channel)`` is its light with LEDs of
    other colors, and ``unknown`` ``(channel,)`` a relative error that this has beside all others;
    colors that are ``unmeasured`` ``(color,)`` have one of their own.
    """

    index: int
    seen: Array
    light: Array
    turns: bool
    reachable: Array
    power: Array
    response: Array
    noise: Array
    led_spread: float
    rewired: Array
    unknown: Array
    unmeasured: NDArray[np.bool_]

    def fits(
        self, light: Array, power: Array, model: Array, unknown: Array | float = 0.0
    ) -> PowerFits:
        """Return how well ``light`` of ``power`` ``(n, color)`` explains all that.

        ``light`` is ``(n, site, channel)``, with one channel where all are alike. The model's
        relative error, ``(n,)``, goes with the light that is there, and so does what is ``unknown``
        of each channel ``(n, channel)``. Where a fiber shines with
        several LEDs, each has a power of its own, which differs by `led_spread`.
        """
        leds = shining(power).sum(axis=1)
        in_channels = power @ self.response
        expected = light * in_channels[:, None, :]
        # The part of a channel's light that is not of its own color.
        own = power @ (self.response * own_channels(self.response))
        leaked = 1 - own / np.where(in_channels > 0, in_channels, np.inf)
        # Channels share the model's error of a site: two say no more of it than one.
        shared = model * np.sqrt(shone_channels(power, self.response).sum(axis=1))
        relative = np.hypot(shared[:, None], LEAK_SPREAD * np.where(in_channels > 0, leaked, 0.0))
        relative = np.hypot(relative, unknown)
        variance = self.noise**2 + (relative[:, None] * np.maximum(self.seen, 0.0)) ** 2
        light2 = np.einsum("nsc,nsc->nc", 1 / variance, expected**2)
        both = np.einsum("nsc,nsc->nc", self.seen / variance, expected)
        seen2 = np.einsum("sc,nsc->nc", self.seen**2, 1 / variance)
        # An LED's own power adds to the covariance what was seen, of rank one in each channel; its
        # inverse and determinant are those of Sherman and Morrison (1950).
        own = np.where(leds > 1, self.led_spread, 0.0)[:, None] ** 2
        added = 1 + own * seen2
        square = (light2 - own * both**2 / added).sum(axis=1)
        best = (both / added).sum(axis=1) / square
        rest = (seen2 / added).sum(axis=1) - best**2 * square
        constant = -0.5 * (np.sum(np.log(variance), axis=(1, 2)) + np.log(added).sum(axis=1))
        return PowerFits(best, 1 / np.sqrt(square), constant - 0.5 * rest)


def _judged(fiber: _Fiber, tolerances: RigTolerances) -> FiberDiagnosis:
    power, middle = fiber.power[None], len(TURNS) // 2
    straight = fiber.light[middle : middle + 1]
    turned = fiber.fits(
        fiber.light, np.repeat(power, len(TURNS), 0), tolerances.model_when_turned(TURNS)
    )
    permuted = swapped_powers(fiber.power, fiber.response)
    unclear = fiber.fits(straight, power, np.array([UNCLEAR_SPREAD]))
    weight = _STEPS * fiber.reachable
    small = weight * np.exp(-0.5 * (TURNS / tolerances.turn) ** 2)
    large = weight * (np.abs(TURNS) >= MIN_TURN)
    usual, loose = around_one(tolerances.power), around_one(2 * tolerances.power)
    evidence = {
        FiberState.OK: _mean(turned.evidence(usual), small),
        FiberState.DEAD: _mean(turned.evidence(between(0.0, DEAD_BELOW)), small),
        FiberState.DIM: _mean(turned.evidence(between(DEAD_BELOW, DIM_BELOW)), small),
        # What a lamp that cannot turn would look like crooked is not known, but that sites differ
        # by as much as when others turn. Its power is no sign of it: dim ones, whose sites noise
        # hides, would be accused of what power drifts by.
        FiberState.MOVED: _mean(turned.evidence(loose if fiber.turns else usual), large),
        FiberState.UNCLEAR: float(unclear.evidence(between(0.0, MAX_POWER))[0]),
    }
    if len(permuted):
        unmeasured = np.any(shining(permuted) & fiber.unmeasured, axis=1)
        swapped = fiber.fits(
            np.repeat(fiber.rewired[None], len(permuted), 0),
            permuted,
            np.full(len(permuted), tolerances.model),
            np.hypot(fiber.unknown, RESPONSE_SPREAD * unmeasured[:, None]),
        )
        evidence[FiberState.SWAPPED] = _mean(swapped.evidence(loose), np.ones(len(permuted)))
    shares = {**FAULT_PRIOR, FiberState.UNCLEAR: 1 - sum(FAULT_PRIOR.values())}
    prior = {state: tolerances.fault * share for state, share in shares.items()}
    prior[FiberState.OK] = 1 - tolerances.fault
    found = posterior({state: log + np.log(prior[state]) for state, log in evidence.items()})
    if not fiber.turns:
        # A lamp that is crooked and dirt before it look alike then.
        found[FiberState.UNCLEAR] += found.pop(FiberState.MOVED)
    return _named(fiber, found, turned, tolerances)


def _named(
    fiber: _Fiber, posterior: dict[FiberState, float], turned: PowerFits, tolerances: RigTolerances
) -> FiberDiagnosis:
    faulty = 1 - posterior[FiberState.OK]
    if faulty <= tolerances.alarm:
        state, confidence = FiberState.OK, posterior[FiberState.OK]
    else:
        state = max((s for s in posterior if s is not FiberState.OK), key=lambda s: posterior[s])
        confidence = posterior[state]
    if state is FiberState.SWAPPED and _one_hue(fiber):
        return FiberDiagnosis(fiber.index, state, confidence, detail=BY_BRIGHTNESS)
    if state is FiberState.UNCLEAR and not fiber.turns:
        return FiberDiagnosis(fiber.index, state, confidence, detail=SIT_STRAIGHT)
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


def swapped_powers(power: Array, response: Array) -> Array:
    """Return ``power`` ``(color,)`` with its colors swapped, ``(n, color)``, in ways that differ.

    They differ to a camera that sees of them what ``response`` ``(color, channel)`` says.
    """
    orders = exchanges(len(power))
    if not orders:
        return np.empty((0, len(power)))
    permuted = power[np.array(orders)]
    differs = np.abs(permuted - power).max(axis=1) > 0.2 * power.max()
    seen = np.abs((permuted - power) @ response).max(axis=1)
    differs &= seen > MIN_SEEN_CHANGE * (power @ response).max()
    return np.asarray(permuted[differs])


BY_BRIGHTNESS = "told by brightness alone, as the camera sees these LEDs in one hue"

SIT_STRAIGHT = "and see that it sits straight"
"""What else is to be done about an unclear lamp that cannot turn."""


def _one_hue(fiber: _Fiber) -> bool:
    """Whether all colors that the fiber may have been swapped for look like its own but dimmer."""
    own = fiber.power @ fiber.response
    others = swapped_powers(fiber.power, fiber.response) @ fiber.response
    scale = others @ own / (own @ own)
    return bool(np.allclose(others, scale[:, None] * own, atol=0.05 * own.max()))


def posterior(logs: dict[Key, float]) -> dict[Key, float]:
    """Return probabilities from the logarithms of evidence times prior."""
    weights = np.exp(np.array(list(logs.values())) - max(logs.values()))
    return dict(zip(logs, (weights / weights.sum()).tolist(), strict=True))


def _mean(evidence: Array, weights: Array) -> float:
    """Return the log of the mean of likelihoods, from their logs."""
    used = weights > 0
    if not used.any():
        return -np.inf
    return float(np.logaddexp.reduce(evidence[used] + np.log(weights[used] / weights[used].sum())))
