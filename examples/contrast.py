"""Contrast of two real sensors beside what is predicted: ``python examples/contrast.py``.

The measured changes are in ``truth/real_sensors``. Exposure, gain and white balance of the cameras
are unknown, so each channel has one gain, fitted at a tilt of 20 deg; how the picture lies on the
skin is found, and its channels may be in reverse order. docs/outside-truth.md has the results.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from truth.comparison import Array, Light, Row, by_color, previewed, rendered, touched

import tactilux
from optimize.readers import CameraModel
from optimize.readers.normal_colors import colors_of_normals
from optimize.readers.normals import angle, plane_parts, random_normals, vectors
from optimize.readers.place_reader import look_up

TILTS, AZIMUTHS = (10.0, 20.0, 30.0), np.arange(0.0, 360.0, 15.0)
WAVE = np.exp(1j * np.radians(AZIMUTHS))[:, None]
ENCODING = 2.2
"""Exponent by which 8-bit pictures are brighter than light: assumed, as sRGB has it."""
BACKGROUND, LESSONS = 110.0, 400
"""Counts of the untouched pad, which are unknown, and normals that are read at each place."""


Orders = tuple[tuple[int, ...], ...]
TWO_WAYS: Orders = ((0, 1, 2), (2, 1, 0))


@dataclass(frozen=True)
class Sensor:
    """A real sensor: its table, mm to a pixel of 640 x 480, orders that its channels may have."""

    table: str
    pixel: float
    orders: Orders


SENSORS = {
    # Taxim, Basics/sensorParams.py: "0.0266 digit".
    "digit": Sensor("digit", 0.0266, TWO_WAYS),
    # gsrobotics: 0.0634 mm at 320 x 240. Which color is on which side is not published.
    "gelsight-mini": Sensor("gelsight_mini", 0.0317, tuple(itertools.permutations(range(3)))),
}
HELD = ("digit=digit", "digit=digit-dome", "gelsight-mini=gelsight-mini")


def measured(name: str) -> Array:
    """Return the changes in counts, ``(x, y, tilt, azimuth, channel)``, of three places each."""
    path = Path(__file__).parent / "truth" / "real_sensors" / f"{name}.csv"
    rows = np.genfromtxt(path, delimiter=",", skip_header=1)
    axes = [np.unique(rows[:, column]) for column in range(4)]
    found = np.empty((*map(len, axes), 3))
    places = (np.searchsorted(axis, rows[:, column]) for column, axis in enumerate(axes))
    found[tuple(places)] = rows[:, 4:]
    return found[:, :, np.isin(axes[2], TILTS)]


def predicted(scene: tactilux.Scene, pixel: float, light: Light) -> tuple[Array, Array]:
    """Return the light of facets ``(x, y, tilt, azimuth, color)`` and of the untouched pad.

    Places are three across and three along the pad, as the pixels of the table lie on the skin.
    """
    facets, untouched = [], []
    for x in (-120 * pixel, 0.0, 120 * pixel):
        sites = {"columns": 1, "rows": 3, "spacing": 160 * pixel, "centre_x": x, "centre_y": 0.0}
        at_x = []
        for tilt in TILTS:
            indenter = {"faces": len(AZIMUTHS), "slope": np.radians(tilt), "radius": 0.8}
            pressed = touched(scene, sites, **indenter)
            seen, dark = light(pressed)
            at_x.append(by_color(pressed, seen))
        facets.append(np.stack(at_x, axis=1))
        untouched.append(by_color(pressed, dark))
    return np.stack(facets), np.stack(untouched)


def encoded(light: tuple[Array, Array], exponent: float) -> Array:
    """Return by how much facets differ from the untouched pad in a picture of that encoding."""
    facets, untouched = (part ** (1.0 / exponent) for part in light)
    return np.asarray(facets - untouched[:, :, None, None])


def laid(change: Array) -> Iterator[Array]:
    """Yield ``change`` as a picture may show it: turned, mirrored, slopes up or down.

    The long side of the picture is the pad's, or the short one.
    """
    for swapped, left, down, up in itertools.product((False, True), (1, -1), (1, -1), (0, 180)):
        shown = change.swapaxes(0, 1) if swapped else change
        shown = shown[::left, ::down]
        along = left * np.cos(np.radians(AZIMUTHS)), down * np.sin(np.radians(AZIMUTHS))
        x, y = along[::-1] if swapped else along
        turned = np.degrees(np.arctan2(y, x)) + up
        yield shown[:, :, :, np.round(turned / 15.0).astype(int) % len(AZIMUTHS)]


def fitted(change: Array, real: Array, orders: Orders) -> Array:
    """Return ``change`` with the gains, the place and the order of channels that fit best.

    Compared are the first harmonics at 20 deg: what is bright all around may be the background.
    """
    goal, best = harmonic(real)[:, :, 1], (np.inf, change)
    for shown, order in itertools.product(laid(change), orders):
        ordered = shown[..., list(order)]
        wave = harmonic(ordered)[:, :, 1]
        gain = (wave.conj() * goal).real.sum(axis=(0, 1)) / (np.abs(wave) ** 2).sum(axis=(0, 1))
        off = float((np.abs(wave * gain - goal) ** 2).sum())
        if (gain > 0.0).all() and off < best[0]:
            best = off, ordered * gain
    return best[1]


def harmonic(change: Array) -> Array:
    """Return the first harmonic over azimuths, complex: how strong, and where brightest."""
    return np.asarray((change * WAVE).mean(axis=-2))


def normal_error(change: Array) -> float:
    """Return the degrees that the *place* reader misses, of changes at the steepest tilt."""
    colors = np.full((1, 9, len(AZIMUTHS) + 1, 3), BACKGROUND)
    colors[0, :, :-1] += change[:, :, -1].reshape(9, len(AZIMUTHS), 3)
    rng, slope = np.random.default_rng(0), float(np.sin(np.radians(TILTS[-1])))
    tilt, azimuth = random_normals(rng, (1, 9, LESSONS))
    seen = CameraModel().recorded(colors_of_normals(colors, tilt, azimuth), rng)
    truth = vectors(plane_parts(slope, tilt, azimuth))
    return float(angle(look_up(colors, seen, slope), truth).mean())


def figures(change: Array, real: Array) -> dict[str, float]:
    """Return what is asked of a prediction, each 0 where it is the measurement."""
    found, goal = (harmonic(part).mean(axis=(0, 1)) for part in (change, real))
    steep = np.abs(found / found[1]) / np.abs(goal / goal[1])
    return {
        "normal error": normal_error(change) / normal_error(real) - 1.0,
        "contrast 10 : 20 : 30 deg": float(np.abs(steep - 1.0).max()),
        "brightest azimuth, deg": float(np.abs(np.degrees(np.angle(found[1] / goal[1]))).max()),
    }


GOALS = {"normal error": 0.25, "contrast 10 : 20 : 30 deg": 0.15, "brightest azimuth, deg": 10.0}


def rows(sensor: Sensor, scene: tactilux.Scene, light: Light) -> Iterator[Row | str]:
    """Yield the goals of a scene, then its contrast by place beside the measured one."""
    real = measured(sensor.table)
    seen = predicted(scene, sensor.pixel, light)
    change = fitted(encoded(seen, ENCODING), real, sensor.orders)
    linear = figures(fitted(encoded(seen, 1.0), real, sensor.orders), real)
    # Turned by a quarter, as no picture lies on the skin.
    wrong = figures(np.roll(change, 6, axis=3), real)
    for what, found in figures(change, real).items():
        beside = {"linear": linear[what], "turned 90 deg": wrong[what]}
        yield Row(f"{scene.name}: {what}", abs(found), f"<= {GOALS[what]:g}", beside)
    yield f"  degrees: {normal_error(change):.2f} predicted, {normal_error(real):.2f} measured"
    for channel in range(3):
        waves = [harmonic(part)[..., channel] for part in (change, real)]
        around = [np.degrees(np.angle(wave[:, :, 1].mean())) for wave in waves]
        by_tilt = [np.abs(wave.mean(axis=(0, 1))) for wave in waves]
        yield f"  channel {channel}       brightest at   by tilt          by place, at 20 deg"
        for who, turn, tilts, wave in zip(
            ("predicted", "measured"), around, by_tilt, waves, strict=True
        ):
            tilted = " ".join(f"{value:4.0f}" for value in tilts)
            placed = " ".join(f"{value:3.0f}" for value in np.abs(wave[:, :, 1]).ravel())
            yield f"    {who:<13}{turn:8.0f} deg   {tilted}   {placed}"


def main(arguments: list[str]) -> int:
    """Print all tables; 1 where a goal is missed."""
    parser = argparse.ArgumentParser(prog="python examples/contrast.py", description=__doc__)
    parser.add_argument("held", nargs="*", default=HELD, help="SENSOR=SCENE, as digit=mine.toml")
    parser.add_argument("--samples", type=int, default=0, help="of the reference, 0: the preview")
    chosen = parser.parse_args(arguments)
    light = partial(rendered, samples=chosen.samples, seed=1) if chosen.samples else previewed
    missed = False
    print(f"{'':<42}{'goal':>8}{'found':>9}")
    for pair in chosen.held:
        name, _, scene = pair.partition("=")
        if name not in SENSORS or not scene:
            parser.error(f"{pair}, allowed: one of {', '.join(SENSORS)}, = and a scene")
        for line in rows(SENSORS[name], tactilux.load_scene(scene), light):
            print(line, flush=True)
            missed |= isinstance(line, Row) and not line.met
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
