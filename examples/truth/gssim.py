"""Five real sensors of gssim, six lights each: two lights say where all stand, four are held out.

Where the lamps are is not published. A ring of Lambertian lamps in air is fitted to each device's
backgrounds of lights 0 and 1 in closed form, with one aim for all devices; tactilux then draws all
six, and facets tilted under each.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from truth.comparison import (
    BLOCK,
    Array,
    Light,
    Row,
    between,
    in_blocks,
    linear,
    off,
    places,
    touched,
)

import tactilux
from render.scene import unchecked

DEVICES = ("gsmax_26D1_P5LX", "series1_1587_M6G0", "series2_2EF6_4JNW", "modulus1690_4E07_XNJU")
"""The fifth, modulus1600, is left out: its lights stand in no ring, its fields are swirled."""


@dataclass(frozen=True)
class Device:
    """One device's six lights on the untouched pad, and how they shade it.

    Arguments:
        x, y: of the middles of blocks, mm.
        fields: linear pictures of the six lights, ``(light, row, column)``.
        slope: of each light's brightness in the middle of the pad, 1/rad: the gradient of its
            logarithm by the tilt of the surface, ``(light,)``.
    """

    x: Array
    y: Array
    fields: Array
    slope: Array

    @staticmethod
    def read(folder: Path, name: str) -> Device:
        """Read ``devices/NAME.yaml`` and ``.png``, which holds six pictures in two rows."""
        text = (folder / "devices" / f"{name}.yaml").read_text(encoding="utf-8")
        width, mm = (float(re.findall(rf"^{key}: (.*)", text, re.M)[0]) for key in SCALE)
        found = re.findall(r"^quadfit:.*?values: \[(.*?)\]", text, re.M | re.S)[0]
        # In the middle only the last of the polynomials' terms counts.
        q = np.array(found.split(","), dtype=float).reshape(-1, 6, 10)[-1]
        gradient = 2 * q[:, [2, 4]] + q[:, [6, 7]]
        tiles = linear(folder / "devices" / f"{name}.png", False)[..., 0]
        rows, columns = tiles.shape[0] // 2, tiles.shape[1] // 3
        lights = tiles.reshape(2, rows, 3, columns).swapaxes(1, 2).reshape(6, rows, columns)
        fields = np.stack([in_blocks(light) for light in lights])
        middle = [BLOCK * (np.arange(n) + 0.5) for n in fields.shape[:0:-1]]
        across, down = np.meshgrid(*middle)
        pixel = mm * width / columns
        return Device(
            (across - columns / 2) * pixel,
            (rows / 2 - down) * pixel,
            fields,
            np.hypot(*gradient.T) / (q[:, 5] + q[:, 8] + q[:, 9]),
        )


SCALE = ("width", "mmperpixel")


@dataclass(frozen=True)
class Ring:
    """Six lamps around the pad, ``radius`` from its axis and ``height`` below it (mm).

    The first stands at the angle ``start``, the next ``turn`` further (rad); they are Lambertian,
    and aimed ``aim`` rad upwards of level, at the axis.
    """

    radius: float
    height: float
    aim: float
    start: float
    turn: float

    def lamp(self, number: int) -> tuple[Array, Array]:
        """Return the place of a lamp (the pad lies at z = 0) and where it shines, ``(3,)``."""
        angle = self.start + number * self.turn
        out = np.array([math.cos(angle), math.sin(angle), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        beam = -math.cos(self.aim) * out + math.sin(self.aim) * up
        return self.radius * out - self.height * up, beam

    def irradiance(self, number: int, x: Array, y: Array) -> Array:
        """Return what a small lamp gives to places of the pad, up to a scale."""
        place, beam = self.lamp(number)
        ray = np.stack([x, y, np.zeros_like(x)], axis=-1) - place
        return np.maximum(ray @ beam, 1e-9) * self.height / (ray**2).sum(axis=-1) ** 2

    @staticmethod
    def fitted(devices: Sequence[Device]) -> list[Ring]:
        """Return the rings that give the backgrounds of lights 0 and 1, each up to its scale.

        Backgrounds hardly know the aim, so all devices, which are of one maker, have one; each
        counts as much as any other, however large its pictures. Least squares of the logarithm.
        """
        starts, turns = np.array([_where(device) for device in devices]).T

        def rings(values: Array) -> list[Ring]:
            places = values[1:].reshape(-1, 3)
            return [
                Ring(radius, height, values[0], start, turn)
                for (radius, height, start), turn in zip(places, turns, strict=True)
            ]

        def residuals(values: Array) -> Array:
            found = []
            for device, ring in zip(devices, rings(values), strict=True):
                for number in (0, 1):
                    drawn = ring.irradiance(number, device.x, device.y)
                    ratio = np.log(drawn / device.fields[number]).ravel()
                    found.append((ratio - ratio.mean()) / math.sqrt(ratio.size))
            return np.concatenate(found)

        halves = np.array([np.ptp(device.x) / 2 for device in devices])
        low = np.stack([0.5 * halves, 0.3 * halves, starts - 1.0], axis=1)
        high = np.stack([10 * halves, 10 * halves, starts + 1.0], axis=1)
        first = np.stack([2 * halves, 2 * halves, starts], axis=1)
        bounds = np.append(-math.pi / 2, low), np.append(math.pi / 2, high)
        return rings(least_squares(residuals, np.append(0.0, first), bounds=bounds).x)

    def scene(self, device: Device) -> tactilux.Scene:
        """Return the scene gelsight-flat, which is in air, with these lamps."""
        flat = tactilux.load_scene("gelsight-flat")
        assert flat.lamps is not None
        lamps = []
        for number in range(6):
            place, beam = self.lamp(number)
            place[2] += flat.pad.thickness
            changed = {"position": tuple(place.tolist()), "direction": tuple(beam.tolist())}
            lamps.append(unchecked(flat.lamps[0], changed | {"diameter": 1.0}))
        half = max(np.ptp(device.x), np.ptp(device.y)) / 2
        sites = {"columns": 6, "rows": 6, "spacing": half / 2.5, "centre_x": 0.0, "centre_y": 0.0}
        scene = touched(flat, sites, radius=0.12 * half, slope=math.radians(20.0))
        return unchecked(scene, {"lamps": tuple(lamps)})


def _where(device: Device) -> tuple[float, float]:
    """Return about where light 0 stands, and how far light 1 is from it (rad)."""
    bright = [field - field.mean() for field in device.fields[:2]]
    first, second = (math.atan2((b * device.y).sum(), (b * device.x).sum()) for b in bright)
    return first, math.copysign(math.pi / 3, math.sin(second - first))


def slopes(scene: tactilux.Scene, facets: Array, sites: Array) -> Array:
    """Return the gradient of the logarithm of brightness by tilt in the middle, 1/rad, ``(lamp,)``.

    Facets of all directions have a first harmonic, of the four sites in the middle, relative to
    what the untouched pad sends from where the facet is.
    """
    pyramid = scene.indenter
    azimuth = 2 * np.pi * np.arange(pyramid.faces) / pyramid.faces
    reach = 2 / 3 * pyramid.radius * math.cos(math.pi / pyramid.faces)
    x, y = places(scene)
    near = np.hypot(x, y) < scene.sites.spacing
    at = x[near, None] + reach * np.sin(azimuth), y[near, None] + reach * np.cos(azimuth)
    flat = np.moveaxis(between(scene, sites.T, *at), -1, 0)
    wave = np.exp(1j * azimuth)
    harmonic = ((facets[:, near] / flat - 1) * wave).mean(axis=(1, 2))
    return np.asarray(np.abs(harmonic) * 2 / math.sin(pyramid.slope))


def rows(folder: Path, light: Light) -> Iterator[Row]:
    """Compare rings fitted to two lights with the other four of each device."""
    held = [2, 3, 4, 5]
    devices = [Device.read(folder, name) for name in DEVICES]
    for name, device, ring in zip(DEVICES, devices, Ring.fitted(devices), strict=True):
        scene = ring.scene(device)
        facets, sites = light(scene)
        flat = between(scene, sites.T, device.x.ravel(), device.y.ravel())[:, held]
        real = device.fields.reshape(6, -1).T[:, held]
        short = name.partition("_")[0]
        beside = {
            "worst light": max(off(flat[:, [k]], real[:, [k]]) for k in range(4)),
            "next light": off(np.roll(flat, 1, axis=1), real),
            "gray": off(np.ones_like(real), real),
        }
        yield Row(f"{short}: background of 4 lights", off(flat, real), "<= 0.06", beside)
        wrong = np.abs(slopes(scene, facets, sites) / device.slope - 1)[held].max()
        fitted = {"radius": ring.radius, "height": ring.height, "aim": math.degrees(ring.aim)}
        yield Row(f"{short}: slope, worst of 4", wrong, "<= 0.2", fitted)
