"""Random rigs with every kind of single-fiber fault, and how many of these faults a check finds.

A random rig has random directions and colors, and differs from the model as real ones do: by the
model's own error (smooth over the pad and over directions), manufacturing tolerances, what drifts
between two starts, the camera's gains and its noise. Where light depends on the channel, many of
its fibers shine in two colors, channels see LEDs of other colors too, and the model errs otherwise
in each channel. LEDs may be of any colors: where channels see several, LEDs are stronger or weaker
than they are said to be.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from hw.check.camera_response import measured_response
from hw.check.commission import RigRecord, commission
from hw.check.diagnosis import Diagnosis, FiberState
from hw.check.image_check import check_image
from hw.check.prediction import PadPrediction
from hw.check.rig_tolerances import (
    MODEL,
    MODEL_LENGTH_SCALE,
    POWER_DRIFT,
    SITE_DRIFT,
    STARTS,
    TURN_DRIFT,
    rig_tolerances,
)
from hw.check.sweep_check import check_sweep
from render.arrays import Array
from render.scene import load_scene

FAULTS = {"dead": FiberState.DEAD, "half power": FiberState.DIM, "swapped": FiberState.SWAPPED,
          "10 deg off": FiberState.MOVED}  # fmt: skip
WAYS = {
    "sweep, commissioned": (True, STARTS), "sweep": (True, 0),
    "image, commissioned": (False, STARTS), "image": (False, 0),
}  # fmt: skip
"""Ways of checking: whether every fiber alone is seen, and starts that the record averages."""
MIN_RECALL, MAX_FALSE_ALARMS = 0.95, 0.01
"""The bound: how many of each fault must be found, at how many false alarms."""


@dataclass(frozen=True)
class RigSpread:
    """How random rigs differ, one standard deviation each.

    Arguments:
        power, turn: of fibers as built, relative and rad.
        power_drift, turn_drift: between two starts.
        gain, gain_drift: of the camera's channels, as built and between two starts.
        model: relative error of the model, smooth over the pad and over directions.
        channel: the part of it that channels have for themselves, where light depends on them:
            `digit` drawn with the albedos 0.7, 0.3 and 0.5 differed so from its renders.
        leak: most that a channel sees of an LED of another color, of its own, in such rigs.
        model_reach: rad, over which that error changes with direction; ``site_reach`` mm.
        shift: relative change of single sites between two starts (camera moved in its seat).
        pixel_noise: counts; 2.55 is 40 dB below full scale.
        pixels, frames: averaged for every site of a sweep.
        strength: most that an LED is seen stronger or weaker than the response says, where channels
            see several colors.
    """

    power: float = 0.08
    turn: float = float(np.radians(1.5))
    power_drift: float = POWER_DRIFT
    turn_drift: float = TURN_DRIFT
    gain: float = 0.05
    gain_drift: float = 0.02
    model: float = MODEL
    channel: float = 0.02
    leak: float = 0.08
    model_reach: float = MODEL_LENGTH_SCALE
    site_reach: float = 5.0
    shift: float = SITE_DRIFT
    pixel_noise: float = 2.55
    pixels: int = 700
    frames: int = 16
    strength: float = 0.15

    @property
    def noise(self) -> float:
        """Of a site's color, in counts."""
        return float(self.pixel_noise / np.sqrt(self.pixels * self.frames))


@dataclass(frozen=True)
class Recall:
    """What a study found for one way of checking.

    Arguments:
        way: the way of checking.
        rigs: number of rigs per fault.
        found: part of the faulty fibers that were reported, by fault.
        named: part that were reported with the right name.
        false_alarms: part of healthy rigs with any report.
        blamed: part of faulty rigs in which a healthy fiber was reported.
    """

    way: str
    rigs: int
    found: dict[str, float]
    named: dict[str, float]
    false_alarms: float
    blamed: float


class RandomRig:
    """One rig: what a camera sees of it, healthy or with a fault.

    Arguments:
        prediction: whose table serves as the model; directions and powers are drawn anew.
        sites: ``(site, 2)`` mm.
        spread: how rigs differ.
        rng: source of all its numbers.
    """

    def __init__(
        self,
        prediction: PadPrediction,
        sites: Array,
        spread: RigSpread,
        rng: np.random.Generator,
    ) -> None:
        """Draw the rig."""
        fibers = len(prediction.phi)
        phi = rng.uniform(np.radians(20.0), np.radians(160.0), fibers)
        response = prediction.response
        colors, channels = response.shape
        color = rng.integers(0, colors, fibers)
        by_channel = prediction.table.ndim == 4
        power, leak = np.eye(colors)[color], np.zeros(response.shape)
        if by_channel:
            # The first fibers, three of each color, shine in that one alone.
            color[:9] = np.arange(9) % 3
            second = (color + rng.integers(1, 3, fibers)) % 3
            mixed = rng.integers(0, 2, fibers) * (np.arange(fibers) >= 9)
            power = np.eye(3)[color] + 0.5 * mixed[:, None] * np.eye(3)[second]
            leak = rng.uniform(0.0, spread.leak, (3, 3)) * (1 - np.eye(3))
        elif not np.array_equal(response, np.eye(3)):
            leak = response * rng.uniform(-spread.strength, spread.strength, response.shape)
        self.prediction = PadPrediction(
            phi, power, prediction.nodes, prediction.table, prediction.score, 0.0, response
        )
        self._rng, self._spread = rng, spread
        error = spread.model * _smooth_fields(prediction.nodes, sites, fibers, spread, rng)
        if by_channel:
            own = [_smooth_fields(prediction.nodes, sites, fibers, spread, rng) for _ in range(3)]
            part = spread.channel / spread.model
            error = np.sqrt(1 - part**2) * error[..., None] + spread.channel * np.stack(own, -1)
        table = prediction.table * np.exp(error)
        self._truth = PadPrediction(
            phi, power, prediction.nodes, table, 0.0, 0.0, response=response + leak
        )
        self._turn = spread.turn * rng.standard_normal(fibers)
        self._power = np.exp(spread.power * rng.standard_normal(fibers))
        gain = np.exp(spread.gain * rng.standard_normal(channels))
        # The sweep is exposed so that the brightest fiber fills most of the range.
        self._gain = 200.0 / (prediction.table.max() * response.max()) * gain
        self._gain_all = gain * 200.0 / (self.prediction.together.max() * gain.max())

    def start(self) -> Callable[[str, int], tuple[Array, Array]]:
        """Return the rig at one start, after its drift: captures by fault and faulty fiber.

        A capture is the sweep ``(fiber, site, channel)`` and the image of all ``(site, channel)``.
        """
        rng, spread = self._rng, self._spread
        fibers, sites = len(self._turn), self._truth.table.shape[2]
        turn = self._turn + spread.turn_drift * rng.standard_normal(fibers)
        power = self._power * np.exp(spread.power_drift * rng.standard_normal(fibers))
        drift = np.exp(spread.gain_drift * rng.standard_normal())
        moved = np.exp(spread.shift * rng.standard_normal(sites))
        colors, channels = self._truth.response.shape
        noise = (
            rng.standard_normal((fibers, sites, channels)),
            rng.standard_normal((sites, channels)),
        )
        side = rng.choice([-1.0, 1.0])
        roll = int(rng.integers(1, colors)) if colors > 1 else 0

        def capture(fault: str, fiber: int) -> tuple[Array, Array]:
            phi, strength = self._truth.phi + turn, power.copy()
            lit = self._truth.power.copy()
            if fault == "dead":
                strength[fiber] = 0.0
            elif fault == "half power":
                strength[fiber] *= 0.5
            elif fault == "swapped":
                lit[fiber] = np.roll(lit[fiber], roll)
            elif fault == "10 deg off":
                phi[fiber] += side * np.radians(10.0)
            light = self._truth.tinted(np.clip(phi, 0.0, np.pi)[:, None])[:, 0]
            seen = strength[:, None] * (lit @ self._truth.response)
            alone = light * moved[:, None] * seen[:, None, :] * drift
            together = alone.sum(axis=0) * self._gain_all
            return (
                alone * self._gain + spread.noise * noise[0],
                together + spread.noise * noise[1],
            )

        return capture


def measure_recall(
    prediction: PadPrediction,
    sites: Array,
    *,
    rigs: int,
    seed: int,
    spread: RigSpread | None = None,
) -> list[Recall]:
    """Return recall and false alarms over ``rigs`` random rigs for each of `WAYS`.

    Arguments are those of `RandomRig`; every rig has a seed of its own.
    """
    spread = spread or RigSpread()
    found = {way: dict.fromkeys(FAULTS, 0) for way in WAYS}
    named = {way: dict.fromkeys(FAULTS, 0) for way in WAYS}
    alarms, blamed = dict.fromkeys(WAYS, 0), dict.fromkeys(WAYS, 0)
    for number in range(rigs):
        rng = np.random.default_rng([seed, number])
        rig = RandomRig(prediction, sites, spread, rng)
        known = np.mean([rig.start()("", 0)[0] for _ in range(STARTS)], axis=0)
        record = commission(rig.prediction, known, load_scene("finger20"), 0.0)
        capture = rig.start()
        fiber = int(rng.integers(len(prediction.phi)))
        for fault in ("", *FAULTS):
            for way, diagnosis in _all_ways(rig, capture(fault, fiber), record, spread):
                reported = {one.index: one.state for one in diagnosis.faults}
                if not fault:
                    alarms[way] += bool(reported)
                    continue
                found[way][fault] += fiber in reported
                named[way][fault] += reported.get(fiber) is FAULTS[fault]
                blamed[way] += bool(reported.keys() - {fiber})
    return [
        Recall(
            way,
            rigs,
            {fault: count / rigs for fault, count in found[way].items()},
            {fault: count / rigs for fault, count in named[way].items()},
            alarms[way] / rigs,
            blamed[way] / rigs / len(FAULTS),
        )
        for way in WAYS
    ]


def _all_ways(
    rig: RandomRig, captured: tuple[Array, Array], record: RigRecord, spread: RigSpread
) -> Iterator[tuple[str, Diagnosis]]:
    alone, together = captured
    for way, (sweep, starts) in WAYS.items():
        known = rig_tolerances(sweep=sweep, starts=starts, noise=np.array(spread.noise))
        check, seen = (check_sweep, alone) if sweep else (check_image, together)
        prediction = rig.prediction
        if starts:
            prediction = replace(prediction, response=record.response)
        elif sweep:
            prediction = replace(prediction, response=measured_response(prediction, alone))
        yield way, check(prediction, seen, known, record.ratio if starts else None)


def _smooth_fields(
    nodes: Array, sites: Array, fibers: int, spread: RigSpread, rng: np.random.Generator
) -> Array:
    """Return fields ``(fiber, node, site)`` of size 1, Gaussian in direction and distance."""
    away = nodes[:, None] - nodes[None]
    over_nodes = np.exp(-0.5 * (away / spread.model_reach) ** 2) + 1e-9 * np.eye(len(nodes))
    far = np.linalg.norm(sites[:, None] - sites[None], axis=-1)
    over_sites = np.exp(-0.5 * (far / spread.site_reach) ** 2) + 1e-9 * np.eye(len(sites))
    draw = rng.standard_normal((fibers, len(nodes), len(sites)))
    return np.asarray(
        np.einsum(
            "nm,fmt,st->fns", np.linalg.cholesky(over_nodes), draw, np.linalg.cholesky(over_sites)
        )
    )
