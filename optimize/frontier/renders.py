"""The rendered rows: short runs of the reference and Mitsuba's own path tracer, resumable."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from optimize.frontier.designs import HeldOut, Nodes
from optimize.frontier.grade import Row, grade
from optimize.frontier.reference import SHORT_SEED, Reference, judge, render_designs
from optimize.frontier.volpath import PathTracer
from render.arrays import Array
from render.files import read_or_drop, write_npz
from render.metric import clip_counts
from render.progress import Progress
from render.reference.job import Sampler
from render.reference.transport import render_transport
from render.scene.schema import Scene

TRACER_SEED = 301
NAMES: dict[Sampler, str] = {"monte-carlo": "bidirectional, MIS", "pssmlt": "PSSMLT"}


def short_rows(
    scene: Scene,
    designs: HeldOut,
    nodes: Nodes,
    reference: Reference,
    samples: list[int],
    checkpoint: Path,
    progress: Callable[[str, Progress], None],
) -> list[Row]:
    """Return one row of the reference per number of samples, the last also by PSSMLT."""
    rows = []
    kinds: list[tuple[int, Sampler]] = [(count, "monte-carlo") for count in samples]
    kinds.append((samples[-1], "pssmlt"))
    for number, (count, sampler) in enumerate(kinds):
        name = f"{NAMES[sampler]}, {count} samples"
        estimate = render_designs(
            scene,
            nodes,
            samples=count,
            seed=SHORT_SEED + number,
            sampler=sampler,
            checkpoint=checkpoint,
            progress=lambda state, name=name: progress(name, state),  # type: ignore[misc]
        )
        found = judge(estimate, nodes, designs, reference.exposure, reference.lam)
        rows.append(
            grade(
                reference,
                name,
                found.counts,
                seconds=found.seconds / len(designs),
                scores=found.scores,
                note=f"{len(designs)} designs in one render",
            )
        )
    return rows


def seconds_alone(
    scene: Scene,
    designs: HeldOut,
    samples: int,
    checkpoint: Path,
    progress: Callable[[Progress], None],
) -> float:
    """Return the seconds of a render of the first design by itself, compiling included."""
    return render_transport(
        scene,
        designs.phi[:1].T,
        np.array(scene.bending.angles),
        samples=samples,
        seeds=[SHORT_SEED],
        checkpoint=checkpoint,
        progress=progress,
    ).seconds


def path_tracer_rows(
    scene: Scene,
    designs: HeldOut,
    reference: Reference,
    spp: list[int],
    folder: Path,
    progress: Callable[[str, int, int], None],
) -> list[Row]:
    """Return one row of Mitsuba's ``volpath`` for each number of samples; every design is kept."""
    tracer = PathTracer(scene, np.array(scene.bending.angles))
    rows = []
    for number, count in enumerate(spp):
        name = f"volpath, {count} samples a pixel"
        radiance, seconds = [], []
        for design in range(len(designs)):
            progress(name, design, len(designs))
            phi, power = designs.phi[design], designs.power[design]
            seed = TRACER_SEED + 1000 * (number + 2 * design)
            path = folder / f"{_key(scene, phi, power, count, seed)}.npz"
            kept = read_or_drop(path, "radiance", "seconds")
            if kept is None:
                found, spent = tracer.radiance(phi, power, count, seed)
                kept = {"radiance": found, "seconds": np.array(spent)}
                write_npz(path, kept)
            radiance.append(kept["radiance"])
            seconds.append(float(kept["seconds"]))
        progress(name, len(designs), len(designs))
        counts = np.asarray(clip_counts(reference.exposure * np.stack(radiance)))
        rows.append(
            grade(
                reference,
                name,
                counts,
                seconds=float(np.median(seconds)),
                note="Mitsuba's own, whole designs; compiling included",
            )
        )
    return rows


def _key(scene: Scene, phi: Array, power: Array, spp: int, seed: int) -> str:
    digest = hashlib.sha256(f"{scene.hash} {spp} {seed}".encode())
    for values in (phi, power):
        digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
    return digest.hexdigest()[:16]
