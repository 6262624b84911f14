"""From photographs to a calibrated scene: test, fit, correct and confirm by renders, write."""

from __future__ import annotations

import math
from dataclasses import asdict
from datetime import date
from pathlib import Path

from hw.calibration.calibrated_scene import calibrated_toml
from hw.calibration.calibration_report import render_report, value_rows
from hw.calibration.line_model import line_model
from hw.calibration.material import NAMES, PER_UNIT, UNITS
from hw.calibration.refine import Confirmation, refine
from hw.calibration.rig_fit import Calibration, fit_rig, measure, require_linearity
from hw.camera.linearity import Linearity
from hw.camera.photo_set import PhotoSet
from hw.errors import CalibrationError
from optimize.design import baseline_design, load_design
from optimize.scoring import open_model
from optimize.ui.console import ProgressBar, note
from optimize.ui.output import fresh_directory, write_manifest
from render.arrays import Array
from render.errors import RenderError
from render.files import write_json, write_text
from render.preview import cache_folder
from render.scene import Scene, load_scene


def calibrate_sets(
    scene_name: str,
    sets: list[PhotoSet],
    bends: Array,
    *,
    linearity_sets: list[PhotoSet],
    design: Path | None,
    model: Path | None,
    target: Path,
    noise: float,
    materials: int,
    samples: int,
) -> dict[str, object]:
    """Test, fit, confirm, write; return what ``calibration.json`` holds.

    Arguments:
        scene_name: shipped name or TOML file.
        sets: one sweep per bend.
        bends: ``(bend,)`` rad.
        linearity_sets: sweeps, one of which shows all fibers together.
        design: whose directions the fibers have; None is the baseline.
        model: folder of the surrogate; None looks for it.
        target: result directory.
        noise: of one pixel, counts.
        materials: how many are rendered to correct the fit, for all rigs of the same design.
        samples: light paths per fiber and cell of the renders that correct and confirm the fit;
            0 leaves them out.
    """
    scene = load_scene(scene_name)
    lighting = baseline_design(scene) if design is None else load_design(design, scene)
    additivity = require_linearity(linearity_sets, noise)
    checker = open_model(scene, model)
    with ProgressBar("Drawing materials") as bar:
        lines = line_model(scene, checker, lighting.phi, bends, bar)
    measurements = measure(scene, sets, bends, noise)
    note(f"Fitting {len(measurements)} photographs of {scene.name}")
    found = fit_rig(scene, lines, measurements)
    today = date.today().isoformat()
    confirmation = None
    if samples:
        note(
            f"Correcting the fit by renders: of {materials} materials, kept for all rigs of this "
            "design, then of what is found"
        )
        with ProgressBar("Rendering") as bar:
            try:
                found, confirmation = refine(
                    scene,
                    lines,
                    found,
                    measurements,
                    lighting.phi,
                    bends,
                    materials=materials,
                    samples=samples,
                    folder=cache_folder(),
                    progress=bar,
                )
            except RenderError as error:
                raise CalibrationError(f"the renders that confirm it failed: {error}") from None
    found.require_known()
    with fresh_directory(target) as work:
        text = calibrated_toml(scene_name, scene, found, today)
        write_text(work / "scene.toml", text)
        after = load_scene(work / "scene.toml")
        report = render_report(scene, found, measurements, bends, additivity, confirmation, today)
        write_text(work / "report.html", report)
        result = _result(scene, after, found, additivity, confirmation, target, today)
        write_json(work / "calibration.json", result, indent=2)
        write_manifest(work, {"scene": str(result["scene"])})
    return result


def _result(
    scene: Scene,
    after: Scene,
    found: Calibration,
    additivity: Linearity,
    confirmation: Confirmation | None,
    target: Path,
    today: str,
) -> dict[str, object]:
    """Return what ``calibration.json`` holds."""
    values = zip(NAMES, UNITS, PER_UNIT, found.material.array(), found.intervals, strict=True)
    material = {
        name: {
            "value": float(value * factor),
            "interval": [float(end * factor) for end in interval],
            "unit": unit,
        }
        for name, unit, factor, value, interval in values
    }
    return {
        "scene": str(target / "scene.toml"),
        "report": str(target / "report.html"),
        "scene_hash": {"before": scene.hash, "after": after.hash},
        "date": today,
        "level": "preview corrected by the surrogate"
        if confirmation is None
        else "preview corrected by the reference",
        "material": material,
        "table": value_rows(scene, found),
        "power": [float(p) if math.isfinite(p) else None for p in found.power],
        "gain": [float(g) if math.isfinite(g) else None for g in found.gain],
        "not_separable": [
            "g and sigma_s",
            "the powers' mean and the gains",
            "the roughness and errors of the model",
        ],
        "hardly_separable": [list(pair) for pair in found.errors.inseparable()],
        "residual": found.chi,
        "linearity": asdict(additivity),
        "confirmation": None if confirmation is None else asdict(confirmation),
    }
