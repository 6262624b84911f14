"""From photographs to a calibrated scene: test, fit, correct and confirm by renders, write."""

from __future__ import annotations

from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from hw.calibrated_powers import FILE
from hw.calibration.calibrated_scene import calibrated_toml
from hw.calibration.calibration_report import render_report
from hw.calibration.line_model import line_model
from hw.calibration.material import NAMES, PER_UNIT, TITLES, UNITS, Material
from hw.calibration.reference_lines import Setup
from hw.calibration.refine import Confirmation, refine
from hw.calibration.rig_fit import Calibration, fit_rig, measure, require_linearity
from hw.camera.linearity import Linearity
from hw.camera.photo_set import PhotoSet
from hw.errors import CalibrationError
from optimize.design import baseline_design, load_design
from optimize.scoring import normal_factor, open_model
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
) -> dict[str, Any]:
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
    setup = Setup(scene, lighting.phi, bends)
    additivity = require_linearity(linearity_sets, noise)
    checker = open_model(scene, model)
    with ProgressBar("Drawing materials") as bar:
        lines = line_model(setup, checker, bar)
    measurements = measure(setup, sets, noise)
    note(f"Fitting {len(measurements)} photographs of {scene.name}")
    found, confirmation = fit_rig(scene, lines, measurements), None
    if samples:
        note(
            f"Correcting the fit by renders: of {materials} materials, kept for all rigs of this "
            "design, then of what is found"
        )
        with ProgressBar("Rendering") as bar:
            try:
                found, confirmation = refine(
                    setup, lines, found, measurements, materials=materials, samples=samples,
                    folder=cache_folder(), progress=bar,
                )  # fmt: skip
            except RenderError as error:
                raise CalibrationError(f"the renders that confirm it failed: {error}") from None
    found.require_known()
    today = date.today().isoformat()
    with fresh_directory(target) as work:
        write_text(work / "scene.toml", calibrated_toml(scene_name, scene, found, today))
        result = {
            "scene": str(target / "scene.toml"),
            "report": str(target / "report.html"),
            "scene_hash": {"before": scene.hash, "after": load_scene(work / "scene.toml").hash},
            "date": today,
            **told(scene, found, additivity, confirmation),
        }
        write_text(work / "report.html", render_report(setup, result, found, measurements))
        write_json(work / FILE, result, indent=2)
        write_manifest(work, {"scene": result["scene"]})
    return result


def told(
    scene: Scene, found: Calibration, additivity: Linearity, confirmation: Confirmation | None
) -> dict[str, Any]:
    """Return what was found, as ``calibration.json`` holds it and the report shows it."""
    power_error = np.full(len(found.power), np.nan)
    power_error[np.isfinite(found.power)] = normal_factor() * found.errors.power
    corrected_by = "surrogate" if confirmation is None else "reference"
    return {
        "level": f"preview corrected by the {corrected_by}",
        "material": fitted_values(scene, found),
        "power": _numbers(found.power),
        "power_error": _numbers(found.power * power_error),
        "gain": _numbers(found.gain),
        "tilt": _numbers(np.degrees(found.tilt)),
        "vignetting": found.vignetting,
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


def fitted_values(scene: Scene, found: Calibration) -> dict[str, dict[str, Any]]:
    """Return value, 95 % interval, the scene's own before, and standard errors by their source.

    By name, all in `UNITS`.
    """
    ends, parts = np.transpose(found.intervals), found.errors.parts
    columns = [found.material.array(), *ends, Material.of(scene).array(), *parts.values()]
    rows = zip(NAMES, TITLES, UNITS, (PER_UNIT * np.stack(columns)).T.tolist(), strict=True)
    return {
        name: {"title": title, "value": value, "interval": [low, high], "unit": unit,
               "before": before, "errors": dict(zip(parts, errors, strict=True))}
        for name, title, unit, (value, low, high, before, *errors) in rows
    }  # fmt: skip


def _numbers(values: Array) -> list[float | None]:
    """Return numbers for JSON, None where they are not finite."""
    return [value if np.isfinite(value) else None for value in values.tolist()]
