"""The rows of a frontier: predictors, a table of renders, and renders of several efforts."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from optimize.design import Array
from optimize.frontier.held_out import FrontierRow, HeldOutReference, Interval
from optimize.frontier.predictors import SHIPPED, SUPERPOSED, Predictor
from render.chebyshev import interpolation_weights
from render.files import read_sealed, write_json
from render.levels import TABLE, Effort, level_of
from render.metric import clip_counts, image_counts
from render.progress import OnProgress, Progress
from render.reference import Sampler
from render.reference.path_tracer import PathTracer
from render.transport import TransportTable

BATCH = 64
"""Designs per call where many are predicted at once."""
ROUNDS = 3
"""How often every call is timed."""
SHORT_SEED, TRACER_SEED = 201, 301
"""Seeds of the short renders and of the path tracer."""
NAMES: dict[Sampler, str] = {"monte-carlo": "bidirectional, MIS", "pssmlt": "PSSMLT"}

Counts = Callable[[Array, Array], Array]
"""From phi ``(design, fiber)`` and power ``(design, fiber, channel)`` to counts
``(design, bend, site, facet, channel)``."""


def timed_row(
    reference: HeldOutReference,
    name: str,
    effort: Effort | None,
    counts: Counts,
    setup: float,
    batch: int = 1,
    interval: Interval | None = None,
) -> FrontierRow:
    """Return errors of ``counts``, and the median seconds that a design takes after a warm-up.

    ``batch`` designs go into a call that is timed; ``setup`` seconds went before the first one.
    """
    phi, power = reference.designs.phi, reference.designs.power
    each = np.arange(batch if batch > 1 else len(phi)).reshape(-1, batch) % len(phi)
    calls = [(phi[pick], power[pick]) for pick in each] * ROUNDS
    counts(*calls[0])
    seconds = []
    for call in calls:
        began = time.perf_counter()
        counts(*call)
        seconds.append((time.perf_counter() - began) / batch)
    values = np.asarray(counts(phi, power))
    row = reference.row(name, values, float(np.median(seconds)), setup=setup, interval=interval)
    return replace(row, level=level_of(effort), effort=effort)


def predictor_rows(
    reference: HeldOutReference, predictor: Predictor, *, batches: bool
) -> list[FrontierRow]:
    """Return the row of a predictor, one design a call; of the shipped model in ``batches`` too."""
    checker, setup = predictor.checker, predictor.seconds
    name, effort = predictor.name, predictor.effort

    def counts(phi: Array, power: Array) -> Array:
        return checker.run(phi, power, reference.designs.bends)["counts"].astype(np.float64)

    held = reference.coverage(checker)
    row = timed_row(reference, name, effort, counts, setup, interval=held)
    rows = [replace(row, photon_noise=checker.photon_noise)]
    if batches and name == SHIPPED:
        name += f", batches of {BATCH}"
        rows.append(timed_row(reference, name, effort, counts, setup, BATCH))
    return rows


def table_row(reference: HeldOutReference, table: TransportTable, setup: float) -> FrontierRow:
    """Return a table of renders, interpolated to the designs' directions."""
    between = interpolation_weights(table.bends, reference.designs.bends)
    cells = np.einsum("ab,fjbsk...->fjask...", between, table.T)

    def counts(phi: Array, power: Array) -> Array:
        weights = interpolation_weights(table.phi, phi)
        light = np.einsum("dfj,fjask...->dfask...", weights, cells, optimize=True)
        return np.asarray(image_counts(light, power, reference.settings.exposure))

    return timed_row(reference, SUPERPOSED, TABLE, counts, setup)


def short_rows(
    reference: HeldOutReference,
    samples: dict[int, str],
    checkpoint: Path,
    report: OnProgress,
    per_pass: int | None,
    *,
    small_steps: bool,
) -> list[FrontierRow]:
    """Return one row of the reference per number of samples, the last also by ``small_steps``.

    ``samples`` have the names of their rungs. Passes of as many paths as the reference's share its
    kernels.
    """
    rows, designs = [], reference.designs
    kinds: list[tuple[int, Sampler]] = [(count, "monte-carlo") for count in samples]
    if small_steps:
        kinds.append((max(samples), "pssmlt"))
    for seed, (count, sampler) in enumerate(kinds, SHORT_SEED):
        name = f"{NAMES[sampler]}, {count} samples"
        renders = designs.render(name, count, seed, checkpoint, report, sampler, per_pass)
        short = HeldOutReference.of(designs, renders, reference.settings)
        rows.append(
            reference.row(
                name,
                short.counts,
                short.seconds / len(designs),
                rung=NAMES[sampler] if sampler == "pssmlt" else samples[count],
                scores=short.scores,
                interval=reference.coverage_of(short),
            )
        )
    return rows


def path_tracer_rows(
    reference: HeldOutReference, spp: list[int], folder: Path, report: OnProgress
) -> list[FrontierRow]:
    """Return one row of Mitsuba's ``volpath`` for each number of samples."""
    designs, exposure, rows = reference.designs, reference.settings.exposure, []
    tracer = PathTracer(designs.scene)
    for number, count in enumerate(spp):
        name = f"volpath, {count} samples a pixel"

        def traced(name: str = name, count: int = count, number: int = number) -> list[FrontierRow]:
            radiance, seconds = [], []
            for index in range(len(designs)):
                report(Progress(index, len(designs), stage=name))
                began, seed = time.perf_counter(), TRACER_SEED + 1000 * (number + 2 * index)
                design = designs.phi[index], designs.power[index]
                radiance.append(tracer.radiance(*design, count, seed))
                seconds.append(time.perf_counter() - began)
            counts = np.asarray(clip_counts(exposure * np.stack(radiance)))
            return [reference.row(name, counts, float(np.median(seconds)), rung="volpath")]

        rows += _kept(folder, reference, name, traced)
    return rows


def _kept(
    folder: Path, reference: HeldOutReference, key: str, make: Callable[[], list[FrontierRow]]
) -> list[FrontierRow]:
    """Return the rows that ``folder`` keeps for this reference and ``key``, or make them."""
    digest = hashlib.sha256(f"{key} {reference.settings} {_hash(reference.counts)}".encode())
    path, kept = folder / f"rows-{digest.hexdigest()[:16]}.json", TypeAdapter(list[FrontierRow])
    with suppress(OSError, ValueError, KeyError):  # none yet, or damaged: then they are made
        return kept.validate_python(read_sealed(path)["rows"])
    rows = make()
    write_json(path, {"rows": kept.dump_python(rows, mode="json")})
    return rows


def _hash(values: Array) -> str:
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
