"""The rows that render nothing: preview, fits on it, the shipped model and a transport table."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch
from pydantic import TypeAdapter

from optimize.frontier.held_out import FrontierRow, HeldOutReference
from render.arrays import Array
from render.chebyshev import interpolation_weights
from render.files import write_bytes
from render.metric import image_counts
from render.preview import Preview
from render.progress import OnProgress
from render.transport import TransportTable
from surrogate.model.checker_module import CheckerModule
from surrogate.model.preview_grid import PreviewGrid
from surrogate.runtime import Checker
from surrogate.training.dataset import cells_from_table
from surrogate.training.evaluation import scene_bends
from surrogate.training.fit import FitConfig, fit_ensembles
from surrogate.training.render_plan import data_hash

BATCH = 64
"""Designs per call where many are predicted at once."""
ROUNDS = 3
"""How often every call is timed."""


Counts = Callable[[Array, Array], Array]
"""From phi ``(design, fiber)`` and power ``(design, fiber, 3)`` to counts
``(design, bend, site, facet, 3)``."""


def timed_row(
    reference: HeldOutReference,
    level: str,
    counts: Counts,
    *,
    setup: float,
    batch: int = 1,
    note: str = "",
) -> FrontierRow:
    """Return errors of ``counts``, and the median seconds that a design takes after a warm-up.

    Arguments:
        reference: what the counts are compared with.
        level: name of the row.
        counts: what the camera will count.
        setup: seconds spent before the first design.
        batch: designs per call when it is timed.
        note: for the reader.
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
    median = float(np.median(seconds))
    return reference.row(level, values, seconds=median, setup=setup, note=note)


def preview_row(reference: HeldOutReference) -> FrontierRow:
    """Return the preview: drawn at the nodes of its lights once, then superposed."""
    began, scene = time.perf_counter(), reference.designs.scene
    with Preview(scene) as preview:

        def counts(phi: Array, power: Array) -> Array:
            transport, _ = preview.transport(phi.T, np.array(scene.bending.angles))
            return np.asarray(image_counts(transport.swapaxes(0, 1), power, reference.exposure))

        counts(np.full((1, scene.fibers.count), 1.0), np.ones((1, scene.fibers.count, 3)))
        setup = time.perf_counter() - began
        return timed_row(reference, "preview", counts, setup=setup)


def model_rows(reference: HeldOutReference, checker: Checker, setup: float) -> list[FrontierRow]:
    """Return the shipped model, one design a call and in batches."""
    bends = np.array(reference.designs.scene.bending.angles)

    def counts(phi: Array, power: Array) -> Array:
        return checker.run(phi, power, bends)["counts"].astype(np.float64)

    alone = timed_row(reference, "checker.onnx", counts, setup=setup, note="one design a call")
    name = f"checker.onnx, batches of {BATCH}"
    return [alone, timed_row(reference, name, counts, setup=setup, batch=BATCH)]


def table_row(reference: HeldOutReference, table: TransportTable, setup: float) -> FrontierRow:
    """Return a reference table, interpolated to the designs' directions."""
    bends = np.array(reference.designs.scene.bending.angles)
    cells = np.einsum("ab,fjbsk->fjask", interpolation_weights(table.bends, bends), table.T)

    def counts(phi: Array, power: Array) -> Array:
        weights = interpolation_weights(table.phi, phi)
        light = np.einsum("dfj,fjask->dfask", weights, cells, optimize=True)
        return np.asarray(image_counts(light, power, reference.exposure))

    note = f"rendered at {len(table.phi)} directions, interpolated; once per scene"
    return timed_row(reference, "transport table", counts, setup=setup, note=note)


def fitted_rows(
    reference: HeldOutReference,
    grid: PreviewGrid,
    table: TransportTable,
    seed: int,
    config: FitConfig,
    folder: Path,
    report: OnProgress,
) -> list[FrontierRow]:
    """Return preview + ridge and preview + network, fitted to ``table`` as ``train`` does.

    They take long, so ``folder`` keeps the rows for the same data.
    """
    digest = hashlib.sha256(f"{data_hash(table)} {seed} {config} {reference.lam}".encode())
    for values in (grid.log_transport, reference.counts, reference.scores):
        digest.update(values.tobytes())
    path = folder / f"fits-{digest.hexdigest()[:16]}.json"
    kept = TypeAdapter(list[FrontierRow])
    with suppress(OSError, ValueError):  # none yet, or damaged: then they are made
        return kept.validate_json(path.read_bytes())
    began, scene = time.perf_counter(), reference.designs.scene
    exposure, lam = reference.exposure, reference.lam
    models = fit_ensembles(
        scene,
        grid,
        cells_from_table(scene, table),
        exposure=exposure,
        lam=lam,
        bends=scene_bends(table, scene.bending.angles),
        seed=seed,
        config=config,
        progress=report,
    )
    seconds, rows = time.perf_counter() - began, []
    bends = torch.tensor([scene.bending.angles], dtype=torch.float32)
    for kind, model in models.items():
        graph = CheckerModule(scene, grid, model, exposure=exposure, lam=lam, spread=(-3.0, 0.0))

        def counts(phi: Array, power: Array, graph: CheckerModule = graph) -> Array:
            lights = (torch.as_tensor(values, dtype=torch.float32) for values in (phi, power))
            with torch.no_grad():
                output = graph(*lights, bends.expand(len(phi), -1))
            return np.asarray(output.counts.double().numpy())

        note = "in torch, on the preview's table"
        rows.append(timed_row(reference, f"preview + {kind}", counts, setup=seconds, note=note))
    write_bytes(path, kept.dump_json(rows))
    return rows
