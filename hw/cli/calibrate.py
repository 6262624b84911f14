"""``tactilux hw calibrate``: photographs in, calibrated scene and report out."""

from __future__ import annotations

import math
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import Option

from hw.cli.options import Gamma, Materials, Noise, Samples, SceneOption
from hw.errors import CalibrationError
from optimize.cli.options import DesignOption, Json, ModelFolder
from optimize.ui.console import ProgressBar, note, print_json, reserved_stdout
from render.errors import RenderError

if TYPE_CHECKING:
    from hw.calibration.refine import Confirmation
    from hw.calibration.rig_fit import Calibration
    from hw.camera.linearity import Linearity
    from hw.camera.photo_set import PhotoSet
    from render.arrays import Array
    from render.scene import Scene


def run(
    flat: Annotated[Path, Option(help="Folder of the sweep with the flat pad.")],
    bent: Annotated[Path, Option(help="Folder of the sweep with the bent pad.")],
    bend: Annotated[
        float, Option(min=1.0, max=180.0, help="Total angle of the bent pad in degrees.")
    ] = 90.0,
    additive: Annotated[
        Path | None,
        Option("--linearity", help="Folder of a sweep with all fibers together as well."),
    ] = None,
    scene_name: SceneOption = "finger20",
    design: DesignOption = None,
    model: ModelFolder = None,
    out: Annotated[
        Path | None, Option(help="Result directory (default: runs/<scene>-calibrate).")
    ] = None,
    gamma: Gamma = 1.0,
    noise: Noise = 2.55,
    materials: Materials = 32,
    samples: Samples = 1000,
    as_json: Json = False,
) -> None:
    """Fit the scene's material, powers and gains to photographs of single fibers."""
    import numpy as np

    from hw.calibration.material import Material
    from hw.camera.photo_set import load_photo_set
    from optimize.ui.output import check_target
    from render.scene import load_scene

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        Material.of(scene)
        target = out or Path("runs") / f"{scene.name}-calibrate"
        check_target(target)
        size = scene.camera.rows, scene.camera.columns
        sets = [load_photo_set(folder, *size, gamma) for folder in (flat, bent)]
        extra = [load_photo_set(additive, *size, gamma)] if additive else []
        result = calibrate_sets(
            scene_name,
            sets,
            np.array([0.0, math.radians(bend)]),
            linearity_sets=[*extra, *sets],
            design=design,
            model=model,
            target=target,
            noise=noise,
            materials=materials,
            samples=samples,
        )
        if as_json:
            print_json(stream, result)
        else:
            print_calibration(stream, result)


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
    from hw.calibration.calibrated_scene import calibrated_toml
    from hw.calibration.calibration_report import render_report
    from hw.calibration.line_model import line_model
    from hw.calibration.refine import refine
    from hw.calibration.rig_fit import fit_rig, measure, require_linearity
    from optimize.design import baseline_design, load_design
    from optimize.scoring import open_model
    from optimize.ui.output import fresh_directory, write_manifest
    from render.files import write_json, write_text
    from render.preview import cache_folder
    from render.scene import load_scene

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
    from hw.calibration.calibration_report import value_rows
    from hw.calibration.material import NAMES, PER_UNIT, UNITS

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


def print_calibration(stream: IO[str], result: dict[str, object]) -> None:
    """Write the fitted values and where everything is."""
    rows = result["table"]
    assert isinstance(rows, list)
    for row in rows:
        stream.write(
            f"{row['title']:<20} {row['value']:>14}   95 % {row['interval']:<20} "
            f"(before: {row['before']})\n"
        )
    stream.write(
        "g and sigma_s cannot be separated by photographs: sigma_s (1 - g) is calibrated, g kept.\n"
        "The roughness is held near the scene's: photographs hardly tell it.\n"
    )
    confirmation = result["confirmation"]
    if isinstance(confirmation, dict):
        stream.write(
            f"Confirmed: along the reference lines, renders of the calibrated scene differ from "
            f"the photographs by {100 * confirmation['rms']:.1f} % rms (noise explains "
            f"{100 * confirmation['noise']:.1f} %; before calibration: "
            f"{100 * confirmation['before']:.1f} %).\n"
        )
    else:
        stream.write("Neither corrected nor confirmed by renders: --samples 1000 does both.\n")
    stream.write(f"Scene: {result['scene']}\nReport: {result['report']}\n")
