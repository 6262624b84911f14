"""From photographs to a calibrated scene: test, fit, correct and confirm by renders, write."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from hw.calibrated_powers import FILE
from hw.calibration.line_model import line_model
from hw.calibration.material import Place
from hw.calibration.measurement import Measurement
from hw.calibration.reference_lines import NAMES as LINES
from hw.calibration.reference_lines import ReferenceLines, Setup
from hw.calibration.refine import Confirmation, refine
from hw.calibration.response import Response, measured_response, skin_color
from hw.calibration.rig_fit import Calibration, fit_rig, measure
from hw.camera.linearity import Linearity, linearity
from hw.camera.photo_set import PhotoSet
from hw.check.orientation import check_orientation
from hw.check.prediction import SiteSpots, predict
from hw.errors import CalibrationError
from optimize.design import baseline_design, load_design
from optimize.report import data_uri, drawing, png_bytes, render_page
from optimize.scoring import normal_factor, open_model
from optimize.ui.console import ProgressBar, note
from optimize.ui.output import fresh_directory, write_manifest
from render.arrays import Array
from render.errors import RenderError
from render.files import write_bytes, write_json, write_text
from render.levels import FEW_RENDERS, SURROGATE
from render.preview import cache_folder
from render.scene import RGB, Palette, Scene, load_scene, standalone


@dataclass(frozen=True, eq=False)
class Sweeps:
    """The photographs of a rig.

    Arguments:
        by_bend: one sweep for each of ``bends`` ``(bend,)`` rad.
        additive: a sweep that also shows all fibers together.
        by_color: sweeps in each LED color alone, or none.
        noise: standard deviation of one pixel, in counts.
    """

    by_bend: list[PhotoSet]
    bends: Array
    additive: PhotoSet
    by_color: list[PhotoSet]
    noise: float


def calibrate_sets(
    scene: Scene,
    sweeps: Sweeps,
    *,
    design: Path | None,
    model: Path | None,
    target: Path,
    materials: int | None,
    samples: int,
) -> dict[str, Any]:
    """Test, fit, confirm, write; return what ``calibration.json`` holds.

    ``design`` None is the baseline, ``model`` None is looked for. ``materials`` (None: as many as
    the polynomial needs) are rendered to correct the fit for all rigs of the same design, with
    ``samples`` light paths per fiber and cell (0: neither corrected nor confirmed).
    """
    kept = standalone(scene)
    lighting = baseline_design(scene) if design is None else load_design(design, scene)
    setup = Setup(scene, lighting.phi, sweeps.bends)
    materials = materials or setup.one_albedo.space.enough
    additivity = linearity(sweeps.additive, sweeps.noise)
    additivity.require()
    checker = open_model(scene, model)
    for bend, photos in zip(sweeps.bends.tolist(), sweeps.by_bend, strict=True):
        fibers = sorted(photos.alone)
        # All LEDs of a fiber were lit; brightness alone says which way up it was seen, and shares
        # of it are the same at a power that no channel exceeds.
        lit = np.full(lighting.drive.shape, 1.0 / max(1.0, scene.palette.matrix.sum(axis=0).max()))
        light = predict(checker, lighting.phi, lit, bend, scene.palette.matrix).alone[fibers]
        seen = np.stack([photos.alone[fiber] for fiber in fibers])
        check_orientation(light, seen, SiteSpots(scene, bend))
    with ProgressBar("Drawing materials") as bar:
        lines = line_model(setup, checker, bar)
    measurements = measure(setup, sweeps.by_bend, sweeps.noise)
    response = None
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
    if sweeps.by_color:
        skin = skin_color(found, measurements) if scene.by_channel else None
        response = measured_response(scene, sweeps.by_color, skin)
    today = date.today().isoformat()
    with fresh_directory(target) as work:
        for name, content in kept.files.items():
            write_bytes(work / name, content)
        write_text(work / "scene.toml", calibrated_toml(kept.text, scene, found, today, response))
        result = {
            "scene": str(target / "scene.toml"),
            "report": str(target / "report.html"),
            "scene_hash": {"before": scene.hash, "after": load_scene(work / "scene.toml").hash},
            "date": today,
            "level": checker.level if confirmation is None else SURROGATE,
            "effort": checker.effort if confirmation is None else FEW_RENDERS,
            **told(scene, found, additivity, confirmation, response),
        }
        write_text(work / "report.html", render_report(setup, result, found, measurements))
        write_json(work / FILE, result, indent=2)
        write_manifest(work, {"scene": result["scene"]})
    return result


def told(
    scene: Scene,
    found: Calibration,
    additivity: Linearity,
    confirmation: Confirmation | None,
    response: Response | None = None,
) -> dict[str, Any]:
    """Return what was found, as ``calibration.json`` holds it and the report shows it."""
    power_error = np.full(len(found.power), np.nan)
    power_error[np.isfinite(found.power)] = normal_factor() * found.errors.power
    return {
        "material": fitted_values(scene, found),
        "power": _numbers(found.power),
        "power_error": _numbers(found.power * power_error),
        "gain": _numbers(found.gain),
        "channels": list(scene.palette.channels),
        "response": None if response is None else told_response(response, scene.palette),
        "tilt": _numbers(np.degrees(found.tilt)),
        "vignetting": found.vignetting,
        "caveats": [*found.space.caveats, *color_caveats(scene.palette)],
        "hardly_separable": [list(pair) for pair in found.errors.inseparable()],
        "residual": found.chi,
        "linearity": asdict(additivity),
        "confirmation": None if confirmation is None else asdict(confirmation),
    }


def color_caveats(palette: Palette) -> list[str]:
    """Return what photographs cannot tell of so many LED colors, one sentence each."""
    if len(palette.names) <= len(palette.channels):
        return []
    return [
        f"{len(palette.names)} LED colors are seen by {len(palette.channels)} "
        f"channel{'s' * (len(palette.channels) > 1)}: a photograph does not tell which LEDs of a "
        "fiber give its light; the powers are those of its LEDs as they were lit together."
    ]


def told_response(response: Response, palette: Palette) -> dict[str, dict[str, Any]]:
    """Return what each channel sees of each LED color, with 95 % intervals, by color."""
    ends = response.interval(normal_factor())
    return {
        color: {"value": value, "interval": interval}
        for color, value, interval in zip(
            palette.names, response.matrix.tolist(), ends.tolist(), strict=True
        )
    }


def fitted_values(scene: Scene, found: Calibration) -> dict[str, dict[str, Any]]:
    """Return value, 95 % interval, the scene's own before, and standard errors by their source.

    By name, all in their units.
    """
    space, parts = found.space, found.errors.parts
    best = space.told(found.material)
    errors = [space.told(found.material + part) - best for part in parts.values()]
    columns = [best, *np.transpose(found.intervals), space.told(space.of(scene)), *errors]
    return {
        one.name: {"title": one.title, "value": value, "interval": [low, high], "unit": one.unit,
                   "before": before, "errors": dict(zip(parts, errors, strict=True))}
        for one, (value, low, high, before, *errors) in zip(
            space.quantities, np.transpose(columns).tolist(), strict=True
        )
    }  # fmt: skip


def _numbers(values: Array) -> list[float | None]:
    """Return numbers for JSON, None where they are not finite."""
    return [value if np.isfinite(value) else None for value in values.tolist()]


SUFFIX = "-calibrated"


def calibrated_toml(
    text: str,
    scene: Scene,
    found: Calibration,
    date: str,
    response: Response | None = None,
) -> str:
    """Return the ``text`` of a scene file with the fitted values put in.

    ``scene`` is what it holds; the ISO ``date`` is written beside each value.
    """
    raw, space = tomllib.loads(text), found.space
    values = zip(space.quantities, space.places, space.factors, strict=True)
    best = space.told(found.material)
    for number, (one, places, factor) in enumerate(values):
        # From fitted values to those of the file.
        value, low, high = (np.array([best[number], *found.intervals[number]]) / factor).tolist()
        said = f"calibrated {date}, 95 % interval {f'{low:.4g} to {high:.4g} {one.unit}'.rstrip()}"
        if number in space.knowledge:
            said += "; weighed with the value before"
        for place in places:
            _put(raw, place, float(f"{value:.6g}"), said)
    if scene.diffuser is not None:
        g = raw["diffuser"]["g"]
        g["source"] = (
            f"{str(g['source']).split(';')[0]}; photographs cannot separate g and sigma_s, only "
            "sigma_s (1 - g) is calibrated"
        )
    if response is not None:
        # Colors are of schema 2.
        raw["schema"] = 2
        inks = {color["name"]: {"ink": color["ink"]} for color in raw.get("colors", ())
                if "ink" in color}  # fmt: skip
        raw["colors"] = [
            {
                "name": color,
                **inks.get(color, {}),
                "response": {
                    "value": [float(f"{value:.4g}") for value in told["value"]],
                    "source": f"calibrated {date}, 95 % intervals "
                    + ", ".join(f"{low:.4g} to {high:.4g}" for low, high in told["interval"]),
                },
            }
            for color, told in told_response(response, scene.palette).items()
        ]
    if not raw["name"].endswith(SUFFIX):
        raw["name"] += SUFFIX
    head = "# Calibrated to photographs by tactilux; powers and gains are in calibration.json.\n"
    return head + _written(raw)


def _put(raw: Any, place: Place, value: float, said: str) -> None:
    """Put ``value`` and its source into the quantity at ``place`` of a scene's file.

    It may be one of several numbers, whose sources follow each other.
    """
    *above, key = place
    for step in above:
        raw = raw[step]
    if key == "sigma_v" and "half_angle" in raw:
        raw[key] = raw.pop("half_angle")
    if isinstance(key, int) and "value" in raw:
        raw["value"][key] = value
        raw["source"] = said if key == 0 else f"{raw['source']}; {said}"
    else:
        raw[key]["value"], raw[key]["source"] = value, said


def _written(raw: dict[str, Any]) -> str:
    """Return TOML of plain keys first, then one table per part with one key per line."""
    tables = {key: item for key, item in raw.items() if _is_table(item)}
    plain = [f"{key} = {_value(item)}" for key, item in raw.items() if key not in tables]
    parts = [
        "\n".join([head, *(f"{key} = {_value(item)}" for key, item in content.items())])
        for part, item in tables.items()
        for head, content in (
            [(f"[{part}]", item)]
            if isinstance(item, dict)
            else [(f"[[{part}]]", entry) for entry in item]
        )
    ]
    return "\n\n".join(["\n".join(plain), *parts]) + "\n"


def _is_table(item: Any) -> bool:
    """Whether ``item`` is a part of a scene, or a list of parts."""
    if isinstance(item, list) and item:
        return all(isinstance(entry, dict) for entry in item)
    return isinstance(item, dict)


def _value(item: Any) -> str:
    if isinstance(item, dict):
        return "{ " + ", ".join(f"{key} = {_value(part)}" for key, part in item.items()) + " }"
    if isinstance(item, list):
        return "[" + ", ".join(map(_value, item)) + "]"
    # Strings and numbers are the same in JSON; TOML has no other numbers here.
    return json.dumps(item, ensure_ascii=False)


SHOWN = 6
"""Photographs whose curves are drawn, spread evenly over all."""


def render_report(
    setup: Setup, result: Mapping[str, Any], found: Calibration, measurements: list[Measurement]
) -> str:
    """Return the HTML text; everything is inside the one file.

    ``setup`` is that before calibration, ``result`` what ``calibration.json`` holds.
    """
    shown = np.unique(np.linspace(0, len(measurements) - 1, SHOWN).round().astype(int)).tolist()
    figures = []
    for one, predicted in ((measurements[index], found.predicted[index]) for index in shown):
        title = f"Fiber {one.fiber}, bend {np.degrees(setup.bends[one.bend]):.0f} deg"
        inks = channel_inks(setup.scene.palette)
        curves = draw_curves(setup.lines, one, found.tilt, predicted, inks)
        figures.append({"title": title, "plot": data_uri(curves)})
    told = {"name": setup.scene.name, "count": len(measurements), "figures": figures}
    return render_page("calibration.html.j2", {**result, **told}, package="hw")


def channel_inks(palette: Palette) -> list[str]:
    """Return what curves of the channels are drawn with: red, green and blue in their own."""
    known = dict(zip(RGB.names, RGB.inks, strict=True))
    return [known.get(name, f"C{number % 10}") for number, name in enumerate(palette.channels)]


def draw_curves(
    lines: ReferenceLines, one: Measurement, tilt: Array, predicted: Array, inks: list[str]
) -> bytes:
    """Return a PNG of the four lines of one photograph: dots measured, lines simulated.

    The camera's ``tilt`` ``(3,)`` rad is undone; ``predicted`` is ``(point, channel)``
    counts, drawn in the ``inks`` of the channels.
    """
    seen = one.untilted(tilt)
    with drawing(11, 2.6) as figure:
        axes = figure.subplots(1, 4, sharey=True)
        for line, plot in enumerate(axes):
            on = (lines.line == line) & one.used
            for channel in one.channels:
                ink = inks[channel]
                plot.plot(lines.place[on], predicted[on, channel], color=ink, lw=1.4)
                plot.plot(lines.place[on], seen[on, channel], ".", color=ink, ms=4)
            plot.set(title=LINES[line], xlabel="mm")
            plot.grid(alpha=0.25)
        axes[0].set(ylabel="counts", ylim=(0, None))
        return png_bytes(figure, dpi=130)
