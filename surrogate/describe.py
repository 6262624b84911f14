"""What a freshly trained model says about itself: sizes, bounds, errors and provenance."""

from __future__ import annotations

import hashlib
import math
import subprocess
from dataclasses import asdict
from importlib import metadata as packages
from pathlib import Path

import numpy as np

from render.metric import THESIS
from render.scene import Scene
from render.transport import TransportTable
from surrogate.fit import Fit
from surrogate.metadata import UNITS, ModelMetadata
from surrogate.preview_grid import InterpolationError, PreviewGrid
from surrogate.uncertainty import COVERAGE

VERSIONED = ("tactilux", "numpy", "torch", "onnx", "mitsuba", "drjit")


def describe_model(
    scene: Scene,
    grid: PreviewGrid,
    preview_error: InterpolationError,
    table: TransportTable,
    fit: Fit,
    renderer: dict[str, object],
) -> ModelMetadata:
    """Return the metadata of a model of ``scene`` fitted to ``table``."""
    return ModelMetadata(
        scene=scene.name,
        scene_hash=scene.hash,
        fibers=scene.fibers.count,
        sites=scene.sites.count,
        facets=scene.indenter.faces,
        scene_bends=list(scene.bending.angles),
        bounds={
            "phi": [0.0, math.pi],
            "power": [0.0, 1.0],
            "bend": [float(grid.bends.min()), float(grid.bends.max())],
        },
        exposure=table.exposure,
        lam=table.lam,
        conventions=asdict(THESIS),
        conformal={
            "coverage": COVERAGE,
            "counts": fit.quantiles.counts,
            "score": fit.quantiles.score,
            "score_spread": fit.quantiles.score_spread,
            "checked": asdict(fit.coverage) if fit.coverage else None,
        },
        held_out=[asdict(row) for row in (*fit.levels, *fit.splits)],
        preview={
            "phi_nodes": len(grid.phi),
            "bend_nodes": len(grid.bends),
            "floored": grid.floored,
            **asdict(preview_error),
        },
        renderer={
            "phi_nodes": len(table.phi),
            "bends_deg": [round(x, 4) for x in np.degrees(table.bends).tolist()],
            **renderer,
        },
        training_data_hash=data_hash(table),
        git_revision=_git_revision(),
        versions=_versions(),
        residual={
            "kind": fit.kind,
            "members": _members(fit),
            "spread": list(fit.spread),
            "unreliable_cells": fit.unreliable,
            "cells": fit.cells,
        },
        units=UNITS,
    )


def data_hash(table: TransportTable) -> str:
    """Return the SHA-256 of the numbers in ``table``, whatever file they are in."""
    digest = hashlib.sha256(table.scene_hash.encode())
    for values in (table.phi, table.bends, table.T, table.se, table.background):
        if values is not None:
            digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
    return digest.hexdigest()


def _members(fit: Fit) -> int:
    return int(next(iter([*fit.residual.buffers(), *fit.residual.parameters()])).shape[0])


def _versions() -> dict[str, str]:
    found = {}
    for name in VERSIONED:
        try:
            found[name] = packages.version(name)
        except packages.PackageNotFoundError:
            continue
    return found


def _git_revision() -> str:
    """Return the commit of the sources, marked when they differ from it.

    The package folders alone count: a model that was made before is no source of the next.
    """
    folder = Path(__file__).parents[1]
    sources = [str(folder / name) for name in ("render", "surrogate", "optimize")]
    try:
        head, changes = (
            subprocess.run(
                ["git", *words], cwd=folder, capture_output=True, text=True, check=True
            ).stdout.strip()
            for words in (["rev-parse", "HEAD"], ["status", "--porcelain", "--", *sources])
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return f"{head}-dirty" if changes else head
