"""A comparison as one HTML file: tables, and the pictures of all designs side by side."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np

from optimize.comparison.comparison import DesignComparison
from optimize.design import find_scene, level_name
from optimize.report import (
    building_steps,
    camera_pictures,
    data_uri,
    design_pictures,
    render_page,
    score_row,
    stage_pictures,
)
from optimize.ui.output import write_result
from optimize.ui.provenance import package_versions

SAMPLES, MORE = 200, 4
"""What the page asks for: samples per cell and seed, and times those that did not decide."""


def write_comparison(path: Path, comparison: DesignComparison, files: list[Path]) -> None:
    """Write the page of ``comparison``, whose designs lie in ``files``, to ``path``."""
    write_result(path, render_comparison(comparison, files).encode())


def render_comparison(comparison: DesignComparison, files: list[Path]) -> str:
    """Return the page as HTML with every picture inside.

    Raises:
        GraphicsError: nothing here can draw what the camera sees.
    """
    scene, stages = comparison.scene, comparison.stages
    pictures = dict(design_pictures(scene, stages)) | dict(camera_pictures(scene, stages))
    bends = scene.state_titles
    best = max(stages, key=lambda stage: stage.rating.score)
    rows = [
        score_row(stage)
        | stage_pictures(pictures, stage.key)
        | {
            "key": stage.key,
            "normal_error": f"{stage.normal_error:.2f}°",
            "seen": [data_uri(pictures[f"preview-{stage.key}-{i}"]) for i in range(len(bends))],
            "best": stage is best,
        }
        for stage in stages
    ]
    file = files[stages.index(best)]
    words = " ".join(shlex.quote(str(file)) for file in files)
    rendered = comparison.samples is not None
    more = SAMPLES if comparison.samples is None else MORE * comparison.samples
    doubt = (
        "These renders do not decide; four times the samples halve the intervals:" if rendered
        else "Let renders decide, all designs with common light paths:"
    )  # fmt: skip
    versions = package_versions("numpy", "onnxruntime", "mitsuba")
    context = {
        "scene": scene.name,
        "scene_hash": scene.hash,
        "level": level_name(comparison.level, stages[0].photon_noise),
        "lam": f"{stages[0].settings.lam:.4g}",
        "confidence": f"{comparison.coverage:.0%}",
        "bends": bends,
        "word": scene.state_word,
        "stages": rows,
        "differences": difference_rows(comparison),
        "covers": comparison.covers,
        "warnings": comparison.warnings,
        "lights": _lights(comparison),
        "rendered": rendered,
        "steps": building_steps(file, find_scene(scene.name, file, scene.hash) or scene.name)
        if comparison.decided
        else [(doubt, f"tactilux compare {words} --samples {more}")],
        "facts": [
            ("Scene", f"{scene.name}, {scene.hash}"),
            *((stage.title, str(file)) for stage, file in zip(stages, files, strict=True)),
            ("Versions", ", ".join(f"{name} {version}" for name, version in versions.items())),
        ],
    }  # fmt: skip
    return render_page("comparison.html.j2", context)


def difference_rows(comparison: DesignComparison) -> list[tuple[str, ...]]:
    """Return every difference as text: pair, value, interval, verdict, and what was changed."""
    return [
        (
            comparison.pair(one),
            f"{one.value:+.2f}",
            "{:+.2f} to {:+.2f}".format(*one.interval),
            comparison.verdict(one),
            f"{one.recolored}",
            f"{one.turned:.1f}°",
        )
        for one in comparison.differences
    ]


def _lights(comparison: DesignComparison) -> list[dict[str, object]]:
    """Return a row per fiber: color and angle under every design, and whether they differ."""
    rows: list[dict[str, object]] = []
    palette = comparison.scene.palette
    designs = [stage.design for stage in comparison.stages]
    for fiber in range(comparison.scene.lamp_count):
        lights = [
            {
                "ink": palette.ink(design.color_names[fiber]),
                "color": design.color_names[fiber],
                "angle": f"{np.degrees(design.phi[fiber]):.1f}°",
            }
            for design in designs
        ]
        differ = any(light != lights[0] for light in lights)
        rows.append({"fiber": fiber, "lights": lights, "differ": differ})
    return rows
