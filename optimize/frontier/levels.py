"""Levels 0 and 1, each as a function from designs to counts, and how long one design takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from optimize.frontier.designs import HeldOut
from render.arrays import Array
from render.chebyshev import interpolation_weights
from render.metric import image_counts
from render.preview.preview import Preview
from render.scene.schema import Scene
from render.transport import TransportTable
from surrogate.runtime.checker import Checker

BATCH = 64
"""Designs per call where many are judged at once."""


@dataclass(frozen=True)
class Level:
    """Something that says what the camera will count.

    Arguments:
        name: of the row.
        counts: from phi ``(design, fiber)`` and power ``(design, fiber, 3)`` to counts
            ``(design, bend, site, facet, 3)``.
        setup: seconds spent before the first design.
        batch: designs per call when it is timed.
        note: for the reader.
    """

    name: str
    counts: Callable[[Array, Array], Array]
    setup: float = 0.0
    batch: int = 1
    note: str = ""


def timed(level: Level, designs: HeldOut, rounds: int = 3) -> tuple[Array, float]:
    """Return the counts of all designs and the median seconds that one takes, after a warm-up."""
    size = level.batch
    if size > 1:
        repeat = np.arange(size) % len(designs)
        phi, power = designs.phi[repeat], designs.power[repeat]
        calls = [(phi, power)] * rounds
    else:
        calls = [
            (designs.phi[i : i + 1], designs.power[i : i + 1]) for i in range(len(designs))
        ] * rounds
    level.counts(*calls[0])
    spent = []
    for call in calls:
        began = time.perf_counter()
        level.counts(*call)
        spent.append((time.perf_counter() - began) / size)
    return np.asarray(level.counts(designs.phi, designs.power)), float(np.median(spent))


@contextmanager
def preview_level(scene: Scene, exposure: float) -> Iterator[Level]:
    """Give the preview: drawn at the nodes of its lights once, then superposed."""
    began = time.perf_counter()
    bends = np.array(scene.bending.angles)
    with Preview(scene) as preview:

        def counts(phi: Array, power: Array) -> Array:
            transport, _ = preview.transport(phi.T, bends)
            return np.asarray(image_counts(transport.swapaxes(0, 1), power, exposure))

        counts(np.full((1, scene.fibers.count), 1.0), np.ones((1, scene.fibers.count, 3)))
        yield Level("preview", counts, time.perf_counter() - began)


def table_level(scene: Scene, table: TransportTable, exposure: float, setup: float) -> Level:
    """Return a reference table, interpolated to the designs' directions."""
    at_bends = interpolation_weights(table.bends, np.array(scene.bending.angles))
    cells = np.einsum("ab,fjbsk->fjask", at_bends, table.T)

    def counts(phi: Array, power: Array) -> Array:
        weights = interpolation_weights(table.phi, phi)
        light = np.einsum("dfj,fjask->dfask", weights, cells, optimize=True)
        return np.asarray(image_counts(light, power, exposure))

    return Level(
        "transport table",
        counts,
        setup,
        note=f"rendered at {len(table.phi)} directions, interpolated; once per scene",
    )


def onnx_levels(scene: Scene, checker: Checker, setup: float) -> tuple[Level, Level]:
    """Return the shipped model, one design a call and in batches."""
    bends = np.array(scene.bending.angles)

    def counts(phi: Array, power: Array) -> Array:
        return checker.run(phi, power, bends)["counts"].astype(np.float64)

    return (
        Level("checker.onnx", counts, setup, note="one design a call"),
        Level(f"checker.onnx, batches of {BATCH}", counts, setup, batch=BATCH),
    )
