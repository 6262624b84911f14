"""Facet colors by simpler means, to compare the reference renderer's cost with.

Both return replicates ``(replicate, target)`` of the radiance of every facet with all fibers lit.
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from render.cells.cell_sampler import Targets, pixel_rays
from render.integrators.emitters import Emission
from render.integrators.subpaths import lens_seen_from
from render.paths.connect import optical_depth
from render.paths.vertex import Vertex, empty_vertex, scattering_value
from render.paths.walk import begin_subpath, sample_scattering, trace_segment
from render.sampling.proposals import LIGHT_EVENTS
from render.sampling.streams import HashedStream
from render.scene import Scene

LANES = 1 << 16


def by_volpath(
    scene: Scene, lit: Any, targets: Targets, passes: int, replicates: int, seed: int
) -> np.ndarray:
    """Mitsuba's ``volpath``, from random pixels of every facet."""
    integrator = mi.load_dict({"type": "volpath", "max_depth": -1, "rr_depth": 1000})
    rng = np.random.default_rng(seed)
    sums = np.zeros((replicates, targets.count))
    counts = np.zeros((replicates, targets.count))
    group = np.arange(LANES) % replicates
    for number in range(passes):
        target = rng.integers(targets.count, size=LANES)
        size = np.diff(targets.offset)[target]
        pixel = targets.pixel[targets.offset[target] + rng.integers(np.maximum(size, 1))]
        columns, rows = scene.camera.columns, scene.camera.rows
        column = mi.Float(((pixel % columns) + rng.random(LANES)).astype(np.float32))
        row = mi.Float(((pixel // columns) + rng.random(LANES)).astype(np.float32))
        o, d = pixel_rays(scene, column, row, columns, rows)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed * 1000 + number, LANES)
        found = integrator.sample(lit, sampler, mi.RayDifferential3f(mi.Ray3f(o, d)))
        value: Any = dr.mean(found[0])
        np.add.at(sums, (group, target), np.array(value, dtype=np.float64))
        np.add.at(counts, (group, target), 1.0)
    return sums / counts


def _sent_to_camera(
    sensor: mi.Sensor, emission: Emission, v: Vertex, active: mi.Bool
) -> tuple[mi.Point2f, mi.Spectrum]:
    """Return where light vertex ``v`` is on the film and what it sends there, without MIS."""
    ds, importance, active = lens_seen_from(sensor, v, mi.Point2f(0.5), active)
    sent = v.beta * scattering_value(v, ds.d, mi.TransportMode.Importance, active) * importance
    eye = empty_vertex()
    near = sensor.near_clip() / dr.select(active, -dr.dot(ds.d, ds.n), 1.0)
    eye.p, eye.volume = ds.p - near * ds.d, mi.Bool(True)
    depth, clear = optical_depth(emission.scene, v, eye, active, emission.nulls)
    return ds.uv, dr.select(active & clear, sent * dr.exp(-depth), 0.0)


@dr.syntax
def _light_tracer(sensor: mi.Sensor, emission: Emission, stream: HashedStream) -> tuple[Any, Any]:
    """Trace light, connect one random vertex that the camera sees to the camera, without MIS."""
    pick, x, y, free = stream.event(mi.UInt32(0))
    u, w, _, _ = stream.event(mi.UInt32(1))
    start = emission.start(pick, mi.Point2f(x, y), u, w)
    state = begin_subpath(
        start.o, start.d, start.medium, start.beta, mi.Float(0), mi.Float(0), free
    )
    event = mi.UInt32(2)
    total, where = mi.Float(0.0), mi.Point2f(0.0)
    active = dr.max(start.beta) > 0
    coated = mi.Bool(False)
    while active:
        state, v, arrived, escaped = trace_segment(emission.scene, state, active)
        v.d_vcm, v.d_vc = mi.Float(0.0), mi.Float(0.0)
        # Facet colors are light that comes from the coating: through the face after it.
        there = arrived & ~v.delta & coated & ~v.volume
        uv, value = _sent_to_camera(sensor, emission, v, there)
        amount = dr.mean(value)
        total += amount
        replaces = (amount > 0) & (stream.event(event + LIGHT_EVENTS)[0] * total < amount)
        where = dr.select(replaces, uv, where)
        coated = dr.select(arrived, v.diffuse, coated)
        numbers = stream.event(event)
        state, alive = sample_scattering(state, v, mi.TransportMode.Importance, numbers, arrived)
        active &= ~escaped & (~arrived | alive) & (event < LIGHT_EVENTS)
        event += 1
    return total, where


def by_light_tracing(
    scene: Scene, lit: Any, targets: Targets, passes: int, replicates: int, seed: int
) -> np.ndarray:
    """Light paths alone, connected to the camera where they leave the silicone."""
    columns, rows = scene.camera.columns, scene.camera.rows
    owner = np.full(columns * rows, targets.count)
    for t in range(targets.count):
        owner[targets.pixel[targets.offset[t] : targets.offset[t + 1]]] = t
    # A film position has density 1: a pixel is worth its solid angle in the film's measure.
    size = np.diff(targets.offset)
    emission = Emission(lit)
    sums = np.zeros((replicates, targets.count + 1))
    group = np.arange(LANES) % replicates
    lane: Any = dr.arange(mi.UInt32, LANES)
    for number in range(passes):
        # A literal would be compiled into the kernel, again for every pass.
        salt: Any = dr.opaque(mi.UInt32, seed * 1000 + number)
        streams, _ = mi.sample_tea_32(lane, salt, 6)
        total, where = _light_tracer(lit.sensors()[0], emission, HashedStream(streams))
        uv = np.array(where).T
        column = np.minimum((uv[:, 0]).astype(int), columns - 1)
        row = np.minimum((uv[:, 1]).astype(int), rows - 1)
        np.add.at(sums, (group, owner[row * columns + column]), np.array(total, dtype=np.float64))
    paths = LANES * passes / replicates
    return sums[:, :-1] / paths * (columns * rows) / np.maximum(size, 1)
