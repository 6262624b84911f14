"""A comparison as one HTML file: tables, and the pictures of all designs side by side."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from optimize.comparison.comparison import DesignComparison
from optimize.design import find_scene, noise_words
from optimize.objectives import READERS
from optimize.report import (
    building_steps,
    camera_pictures,
    data_uri,
    degrees_row,
    design_pictures,
    render_page,
    score_row,
    stage_pictures,
)
from optimize.ui.output import write_result
from optimize.ui.provenance import package_versions
from render.scene import Scene

NONE = "–"
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
    stages, scenes, best = comparison.stages, comparison.scenes, comparison.best
    pictures: dict[str, bytes] = {}
    for scene in scenes:
        own = [stage for stage in stages if stage.scene.hash == scene.hash]
        pictures |= dict(design_pictures(scene, own)) | dict(camera_pictures(scene, own))
    rows = [
        score_row(stage)
        | stage_pictures(pictures, stage.key)
        | {
            "key": stage.key,
            **degrees_row(stage),
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
        "scene": ", ".join(scene.name for scene in scenes),
        "sensors": [{"name": scene.name, "hash": scene.hash} for scene in scenes],
        "level": ", ".join(
            dict.fromkeys(
                stage.rating.level_name + noise_words(stage.photon_noise) for stage in stages
            )
        ),
        "lam": ", ".join(dict.fromkeys(f"{stage.settings.lam:.4g}" for stage in stages)),
        "confidence": f"{comparison.coverage:.0%}",
        "word": scenes[0].state_word,
        "bends": max((scene.state_titles for scene in scenes), key=len),
        "views": _views(comparison, pictures),
        "stages": rows,
        "differences": difference_rows(comparison),
        "covers": comparison.covers,
        "warnings": comparison.warnings,
        "lights": _lights(comparison) if len(scenes) == 1 else [],
        "rendered": rendered,
        "steps": building_steps(file, _scene_file(best.scene, file))
        if comparison.decided
        else [(doubt, f"tactilux compare {words} --samples {more}")],
        "facts": [
            *(("Scene", f"{scene.name}, {scene.hash}") for scene in scenes),
            *((stage.title, str(file)) for stage, file in zip(stages, files, strict=True)),
            ("Versions", ", ".join(f"{name} {version}" for name, version in versions.items())),
        ],
    }  # fmt: skip
    return render_page("comparison.html.j2", context)


def difference_rows(comparison: DesignComparison) -> list[tuple[str, ...]]:
    """Return every difference as text: pair, by readers and in S, verdict, what was changed.

    What two sensors cannot be compared in is a dash.
    """
    return [
        (
            comparison.pair(one),
            *(_signed(one.errors[reader], "°") for reader in READERS),
            NONE if one.score is None else _signed(one.score),
            comparison.verdict(one),
            NONE if one.recolored is None else f"{one.recolored}",
            NONE if one.turned is None else f"{one.turned:.1f}°",
        )
        for one in comparison.differences
    ]


def _signed(difference: tuple[float, tuple[float, float]], unit: str = "") -> str:
    value, (low, high) = difference
    return f"{value:+.2f}{unit}, {low:+.2f} to {high:+.2f}"


def _scene_file(scene: Scene, design: Path) -> str:
    return str(find_scene(scene.name, design, scene.hash) or scene.name)


def _views(comparison: DesignComparison, pictures: Mapping[str, bytes]) -> list[dict[str, Any]]:
    """Return what the camera sees, state by state: a title, and a picture of each design."""
    stages = comparison.stages
    views = []
    for index in range(max(len(stage.scene.state_axis) for stage in stages)):
        shown = [stage for stage in stages if index < len(stage.scene.state_axis)]
        titles = dict.fromkeys(stage.scene.state_titles[index] for stage in shown)
        seen = [
            {"title": stage.title, "data": data_uri(pictures[f"preview-{stage.key}-{index}"])}
            for stage in shown
        ]
        views.append({"title": ", ".join(filter(None, titles)), "pictures": seen})
    return views


def _lights(comparison: DesignComparison) -> list[dict[str, object]]:
    """Return a row per fiber: color and angle under every design, and whether they differ."""
    rows: list[dict[str, object]] = []
    (scene,) = comparison.scenes
    palette = scene.palette
    designs = [stage.design for stage in comparison.stages]
    for fiber in range(scene.lamp_count):
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
