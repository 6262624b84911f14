"""What a fresh model says about itself: its metadata, and the model card for people.

Sizes and bounds, what it was made from, how wrong it is, and when not to use it.
"""

from __future__ import annotations

import os
import platform
import subprocess
from dataclasses import asdict, dataclass
from importlib import metadata as packages
from pathlib import Path
from typing import Any

import numpy as np

from render.levels import CONVERGED, TABLE
from render.reference import more_effort
from render.scene import Scene
from surrogate.model.preview_grid import PreviewGrid
from surrogate.model.scene_facts import grid_facts, scene_facts
from surrogate.preview_model import CONVERGED_ERRORS
from surrogate.runtime import family_hash
from surrogate.runtime.metadata import NONE, UNITS, ModelMetadata, held_out_row
from surrogate.training.conformal import COVERAGE
from surrogate.training.fit import Fit
from surrogate.training.render_plan import ReferenceData
from surrogate.training.training_preview import TrainingPreview

VERSIONED = ("tactilux", "numpy", "torch", "onnx", "mitsuba", "drjit")


@dataclass(frozen=True)
class Provenance:
    """How the model was made: the exact command, its seed and the seconds of rendering and fit."""

    command: str
    seed: int
    seconds: dict[str, float]


def describe_model(
    scene: Scene,
    preview: TrainingPreview,
    reference: ReferenceData,
    fit: Fit,
) -> ModelMetadata:
    """Return the metadata of a model of ``scene`` fitted to ``reference``."""
    table, grid, left_out = reference.tables[0], preview.grid, preview.left_out
    traced = CONVERGED if preview.converged else None
    halves = all(table.half_difference is not None for table in reference.tables)
    return ModelMetadata(
        **scene_facts(scene, grid),
        exposure=table.exposure,
        lam=table.lam,
        conformal={
            "coverage": COVERAGE,
            "counts": fit.quantiles.counts,
            "score": fit.quantiles.score,
            "score_spread": fit.quantiles.score_spread,
            "effort": fit.quantiles.effort,
            "checked": asdict(fit.coverage) if fit.coverage else None,
        },
        held_out=[
            held_out_row(asdict(row), traced, fit.kind) for row in (*fit.levels, *fit.splits)
        ],
        preview={
            **grid_facts(grid),
            "effort": traced,
            **asdict(preview.error),
            **({} if left_out is None else {"materials": asdict(left_out)}),
            # A residual that halves of the renders bear out makes no ranking worse.
            **({"ranks": CONVERGED_ERRORS.kendall_tau} if preview.converged and halves else {}),
        },
        renderer={
            "phi_nodes": len(table.phi),
            **(
                {"states": list(scene.state_names)}
                if scene.states is not None
                else {"bends_deg": [round(x, 4) for x in np.degrees(table.bends).tolist()]}
            ),
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
        material=_free_material(scene, grid, reference),
    )


def _free_material(scene: Scene, grid: PreviewGrid, reference: ReferenceData) -> dict[str, object]:
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


def machine() -> str:
    """Return the processor and the number of cores."""
    model = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    for line in lines:
        if line.startswith("model name"):
            model = line.split(":", 1)[1].strip()
            break
    return f"{model}, {os.cpu_count()} cores"


def write_card(metadata: ModelMetadata, fit: Fit, made: Provenance) -> str:
    """Return ``checker.md``."""
    conformal, preview = metadata.conformal, metadata.preview
    checked = conformal["checked"]
    found = (
        f"{checked['counts']:.1%} of facet colors and {checked['score']:.1%} of scores"
        if checked
        else "not checked: one direction node only"
    )
    settings = [f"- {key}: {value}" for key, value in metadata.renderer.items()]
    unproven = unproven_interval(metadata)
    return "\n".join(
        [
            f"# Surrogate of {metadata.scene}",
            "",
            "In a robot: what the camera should see under its lighting design, of the untouched "
            "pad and of facets that are pressed into it; the start-up check compares photographs "
            "with it. It does not read tactile images.",
            "",
            "Predicts the camera colors of every facet, with a spread, the metric and the score "
            f"of a lighting design, from {_made_of(fit, metadata.preview_name)}.",
            "",
            "## Axes",
            "",
            *(f"- {name}: {text}" for name, text in metadata.axes.items()),
            "",
            "## How it was made",
            "",
            f"- command: `{made.command}`",
            f"- seed: {made.seed}",
            f"- machine: {machine()}",
            "- seconds: " + ", ".join(f"{took:.0f} {what}" for what, took in made.seconds.items()),
            f"- scene: {metadata.scene}, hash {metadata.scene_hash}",
            f"- training data: SHA-256 {metadata.training_data_hash}",
            f"- sources: {metadata.git_revision}",
            "- versions: " + ", ".join(f"{k} {v}" for k, v in metadata.versions.items()),
            f"- license: {metadata.licence}",
            "",
            "Reference renderer:",
            "",
            *settings,
            f"- cells: {fit.cells}, median relative standard error {fit.noise:.1%}",
            f"- unreliable: {fit.unreliable} cells, uncertain by half or more, as those are that "
            "few light paths carry; "
            "fitted with their weight, left out of the errors of single cells",
            "",
            f"Residual: {metadata.residual['kind']}, {metadata.residual['members']} members.",
            f"{metadata.preview_name.capitalize()}: {preview['phi_nodes']} x "
            f"{preview['bend_nodes']} nodes; between them the shader's "
            f"interpolation is off by {preview['median']:.2%} (median), {preview['p95']:.2%} "
            f"(95th percentile), {preview['worst']:.1%} (worst cell); {preview['floored']} cells "
            "were black and hold the floor.",
            "",
            "## Errors on held-out designs",
            "",
            f"{_held_out(fit, metadata)} The reference's own noise is part of all numbers but one: "
            "with noise of this size in both, even the reference rendered again would show the "
            "first row. Colors: length of the difference over length of the reference's color. "
            "Scores in counts.",
            "",
            *_table(metadata.held_out[: len(fit.levels)]),
            "",
            *_splits(fit, metadata),
            "## Intervals",
            "",
            "For the reference without its noise; compared with a render, the render's own error "
            "bar is added in quadrature.",
            f"At {conformal['coverage']:.0%}: a channel of a facet lies within "
            f"{conformal['counts']:.2f} times `counts_spread`, a score within "
            f"{conformal['score']:.2f} counts. Tried on designs made of other "
            f"{'light paths' if fit.by_paths else 'cells'}, these held {found}.",
            *([f"Note: {unproven}"] if unproven else []),
            "",
            "## Limits",
            "",
            f"- Trained for {_ranges(metadata)} of this scene. Outside, inputs are "
            "moved to the edge of the range and `domain_excess` is positive; inputs that are not "
            "finite give NaN.",
            "- Random designs set the intervals. A search that picks the best of very many "
            "designs finds errors too: verify its result with `tactilux verify`.",
            _family(metadata),
            "- Errors of the reference (facets of finite size, an ideal black body, no light "
            "bending with the pad) are not in the intervals.",
            "",
        ]
    )


def unproven_interval(metadata: ModelMetadata) -> str:
    """Say that the renders could not test the interval of scores; "" where they did."""
    effort, samples = metadata.conformal["effort"], metadata.renderer.get("samples_per_cell")
    if effort <= 1.0:
        return ""
    asked = more_effort(effort, int(samples) if isinstance(samples, int) else None)
    return (
        f"the interval of scores, +- {metadata.conformal['score']:.2f} counts, is that of the "
        f"{metadata.preview_name} and unproven: the renders are too noisy to test it; {asked}."
    )


def _ranges(metadata: ModelMetadata) -> str:
    """Return what the inputs cover."""
    if metadata.states:
        states = ", ".join(f"{number} {name}" for number, name in enumerate(metadata.states))
        return f"phi 0 to 180 deg, power 0 to 1 and the states {states}"
    if len(metadata.scene_bends) == 1:
        return "phi 0 to 180 deg and power 0 to 1"
    low, high = metadata.bounds["bend"]
    return f"phi 0 to 180 deg, power 0 to 1 and bend {_degrees(low)} to {_degrees(high)} deg"


def _made_of(fit: Fit, preview: str) -> str:
    renders = (
        "renders of the reference (bidirectional path tracing with multiple importance sampling)"
    )
    if fit.kind == NONE:
        return f"the {preview} alone: {renders} bore out no correction"
    if fit.kind == TABLE:
        return f"the {preview} and, cell by cell as far as they are known, {renders}"
    return f"the {preview} and a residual that was learned from {renders}"


def _held_out(fit: Fit, metadata: ModelMetadata) -> str:
    if fit.by_paths:
        return (
            "No lamp of this sensor turns, and it does not bend: a design superposes cells that "
            "were rendered. The table's errors are those of one half of the light paths against "
            "the other half; the whole is closer. Its tau is that of the whole (Spearman and "
            "Brown), and all are of normal scores with the correlation of these."
        )
    together = "position, direction and state" if metadata.states else (
        "position, direction and bend" if len(metadata.scene_bends) > 1 else
        "position and direction"
    )  # fmt: skip
    return (
        "Every cell of these random designs was predicted by a member that did not see its fiber "
        f"{together} together."
    )


def _splits(fit: Fit, metadata: ModelMetadata) -> list[str]:
    if not fit.splits:
        return []
    # A named state is no value between others: none is left out.
    bends = not metadata.states and len(metadata.scene_bends) > 1
    parts = "positions, directions or bends" if bends else "positions or directions"
    return [
        f"The same with whole fiber {parts} left out (fitted with half the "
        "steps and a third of the data missing):",
        "",
        *_table(metadata.held_out[len(fit.levels) :]),
        "",
    ]


def _family(metadata: ModelMetadata) -> str:
    free = metadata.material
    if not free:
        return (
            "- It knows this scene alone: another pad, material, camera or indenter needs its own "
            "model."
        )
    rows = zip(free["names"], free["low"], free["high"], strict=True)
    ranges = ", ".join(f"{name} {low:g} to {high:g}" for name, low, high in rows)
    return (
        f"- Its input `material` holds {ranges} (1/mm, mm); it serves every scene that differs in "
        "these alone. Another pad, camera or indenter needs its own model."
    )


def _table(rows: list[dict[str, Any]]) -> list[str]:
    head = [
        "| prediction | cell, median | cell, 95 % | color, median | color, 95 % | color, rms "
        "| color, rms without noise | score, median "
        "| score, 95 % | Kendall tau |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    return head + [
        "| {name} | {cell_median:.1%} | {cell_p95:.1%} | {facet_median:.1%} | {facet_p95:.1%} "
        "| {facet_rms:.1%} | {facet_rms_true:.1%} | {score_median:.2f} | {score_p95:.2f} "
        "| {kendall_tau:.2f} |".format(**row)
        for row in rows
    ]


def _degrees(radians: float) -> str:
    return f"{radians * 57.29577951308232:g}"
