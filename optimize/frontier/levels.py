"""The levels of the ladder: preview, fits on it, the shipped model, a transport table, renders."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import torch
from pydantic import TypeAdapter

from optimize.design import Array
from optimize.frontier.held_out import FrontierRow, HeldOutReference
from render.chebyshev import interpolation_weights
from render.files import write_bytes
from render.metric import clip_counts, image_counts
from render.preview import Preview
from render.progress import OnProgress, Progress
from render.reference import Sampler
from render.reference.path_tracer import PathTracer
from render.transport import TransportTable
from surrogate.model.checker_module import CheckerModule
from surrogate.model.preview_grid import PreviewGrid
from surrogate.runtime import Checker
from surrogate.training.dataset import training_cells
from surrogate.training.ensembles import fit_ensembles
from surrogate.training.evaluation import scene_bends
from surrogate.training.fit_task import FitConfig, FitTask
from surrogate.training.render_plan import data_hash

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
    reference: HeldOutReference, level: str, counts: Counts, setup: float, batch: int = 1
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
    return reference.row(level, values, float(np.median(seconds)), setup=setup)


def preview_row(reference: HeldOutReference) -> FrontierRow:
    """Return the preview: drawn at the nodes of its lights once, then superposed."""
    began, scene = time.perf_counter(), reference.designs.scene
    with Preview(scene) as preview:

        def counts(phi: Array, power: Array) -> Array:
            light = preview.transport(phi.T, reference.designs.bends)[0].swapaxes(0, 1)
            return np.asarray(image_counts(light, power, reference.settings.exposure))

        counts(
            np.full((1, scene.lamp_count), 1.0),
            np.ones((1, scene.lamp_count, len(scene.palette.channels))),
        )
        return timed_row(reference, "preview", counts, time.perf_counter() - began)


def converged_row(reference: HeldOutReference, checker: Checker, setup: float) -> FrontierRow:
    """Return the converged preview: light followed to every facet once, then superposed."""
    return timed_row(reference, checker.level, _counts_of(checker, reference), setup)


def _counts_of(checker: Checker, reference: HeldOutReference) -> Counts:
    def counts(phi: Array, power: Array) -> Array:
        return checker.run(phi, power, reference.designs.bends)["counts"].astype(np.float64)

    return counts


def model_rows(reference: HeldOutReference, checker: Checker, setup: float) -> list[FrontierRow]:
    """Return the trained model, one design a call and in batches; nothing where there is none."""
    if checker.file is None:
        return []
    counts = _counts_of(checker, reference)
    alone = timed_row(reference, "checker.onnx", counts, setup)
    name = f"checker.onnx, batches of {BATCH}"
    return [alone, timed_row(reference, name, counts, setup, BATCH)]


def table_row(reference: HeldOutReference, table: TransportTable, setup: float) -> FrontierRow:
    """Return a reference table, interpolated to the designs' directions."""
    between = interpolation_weights(table.bends, reference.designs.bends)
    cells = np.einsum("ab,fjbsk...->fjask...", between, table.T)

    def counts(phi: Array, power: Array) -> Array:
        weights = interpolation_weights(table.phi, phi)
        light = np.einsum("dfj,fjask...->dfask...", weights, cells, optimize=True)
        return np.asarray(image_counts(light, power, reference.settings.exposure))

    return timed_row(reference, "transport table", counts, setup)


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

    Networks that the renders of the table do not bear out are left out.
    """
    scene, settings = reference.designs.scene, reference.settings
    exposure, lam = settings.exposure, settings.lam

    def fitted() -> list[FrontierRow]:
        began, rows = time.perf_counter(), []
        cells, angles = training_cells(scene, [table]), scene.bending.angles
        task = FitTask(scene, grid, cells, exposure, lam, scene_bends(table, angles), seed, config)
        both = fit_ensembles(task, report)
        models = {"ridge": both.ridge}
        if both.network is not None:
            models["network"] = both.network
        seconds, bends = time.perf_counter() - began, torch.tensor([angles], dtype=torch.float32)
        for kind, model in models.items():
            graph = CheckerModule(
                scene, grid, model, exposure=exposure, lam=lam, spread=(-3.0, 0.0)
            )

            def counts(phi: Array, power: Array, graph: CheckerModule = graph) -> Array:
                lights = (torch.as_tensor(values, dtype=torch.float32) for values in (phi, power))
                with torch.no_grad():
                    output = graph(*lights, bends.expand(len(phi), -1))
                return np.asarray(output.counts.double().numpy())

            rows.append(timed_row(reference, f"preview + {kind}", counts, seconds))
        return rows

    key = f"{data_hash(table)} {seed} {config} {_hash(grid.log_transport)}"
    return _kept(folder, reference, key, fitted)


def short_rows(
    reference: HeldOutReference,
    samples: list[int],
    checkpoint: Path,
    report: OnProgress,
    per_pass: int | None,
    *,
    small_steps: bool,
) -> list[FrontierRow]:
    """Return one row of the reference per number of samples, the last also by ``small_steps``.

    Passes of as many paths as the reference's share its kernels.
    """
    rows, designs = [], reference.designs
    kinds: list[tuple[int, Sampler]] = [(count, "monte-carlo") for count in samples]
    if small_steps:
        kinds.append((samples[-1], "pssmlt"))
    for seed, (count, sampler) in enumerate(kinds, SHORT_SEED):
        name = f"{NAMES[sampler]}, {count} samples"
        renders = designs.render(name, count, seed, checkpoint, report, sampler, per_pass)
        short = HeldOutReference.of(designs, renders, reference.settings)
        seconds = short.seconds / len(designs)
        rows.append(reference.row(name, short.counts, seconds, scores=short.scores))
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
            return [reference.row(name, counts, float(np.median(seconds)))]

        rows += _kept(folder, reference, name, traced)
    return rows


def _kept(
    folder: Path, reference: HeldOutReference, key: str, make: Callable[[], list[FrontierRow]]
) -> list[FrontierRow]:
    """Return the rows that ``folder`` keeps for this reference and ``key``, or make them."""
    digest = hashlib.sha256(f"{key} {reference.settings} {_hash(reference.counts)}".encode())
    path, kept = folder / f"rows-{digest.hexdigest()[:16]}.json", TypeAdapter(list[FrontierRow])
    with suppress(OSError, ValueError):  # none yet, or damaged: then they are made
        return kept.validate_json(path.read_bytes())
    rows = make()
    write_bytes(path, kept.dump_json(rows))
    return rows


def _hash(values: Array) -> str:
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
