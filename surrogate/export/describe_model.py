"""What a freshly trained model says about itself: sizes, bounds, errors and provenance."""

from __future__ import annotations

import math
import subprocess
from dataclasses import asdict
from importlib import metadata as packages
from pathlib import Path

import numpy as np

from render.metric import THESIS
from render.scene.schema import Scene
from surrogate.model.material_grid import LeftOut
from surrogate.model.materials import family_hash
from surrogate.model.preview_grid import InterpolationError, PreviewGrid
from surrogate.runtime.metadata import UNITS, ModelMetadata
from surrogate.training.conformal import COVERAGE
from surrogate.training.fit import Fit
from surrogate.training.reference_data import Reference

VERSIONED = ("tactilux", "numpy", "torch", "onnx", "mitsuba", "drjit")


def describe_model(
    scene: Scene,
    grid: PreviewGrid,
    preview_error: InterpolationError,
    left_out: LeftOut | None,
    reference: Reference,
    fit: Fit,
) -> ModelMetadata:
    """Return the metadata of a model of ``scene`` fitted to ``reference``.

    ``left_out`` is the error of the preview at materials that it was not drawn for.
    """
    table = reference.tables[0]
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
            **({} if left_out is None else {"materials": asdict(left_out)}),
        },
        renderer={
            "phi_nodes": len(table.phi),
            "bends_deg": [round(x, 4) for x in np.degrees(table.bends).tolist()],
            **reference.renderer,
        },
        training_data_hash=reference.hash,
        git_revision=_git_revision(),
        versions=_versions(),
        residual={
            "kind": fit.kind,
            "members": _members(fit),
            "spread": list(fit.spread),
            "unreliable_cells": fit.unreliable,
            "cells": fit.cells,
        },
        units=UNITS | ({} if grid.free is None else {"material": "1/mm, mm"}),
        material=_material(scene, grid, reference),
    )


def _material(scene: Scene, grid: PreviewGrid, reference: Reference) -> dict[str, object]:
    free = grid.free
    if free is None or reference.materials is None:
        return {}
    return {
        "names": list(free.names),
        "low": free.low.tolist(),
        "high": free.high.tolist(),
        "nominal": free.nominal.tolist(),
        "rendered": reference.materials.tolist(),
        "family": family_hash(scene, free.names),
    }


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
    folder = Path(__file__).parents[2]
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
