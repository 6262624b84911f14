"""``tactilux check``: does the rig look as its design says?

Imports numpy, onnxruntime and what reads files; OpenCV and pyserial only for a live camera.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

from hw.camera.photo import check_photo, linear, read_photo
from hw.camera.photo_set import PhotoSet, load_photo_set
from hw.check.channel_order import check_order
from hw.check.commission import RigRecord, commission, load_record
from hw.check.diagnosis import WORDS, Diagnosis, FiberState
from hw.check.image_check import check_image
from hw.check.prediction import PadPrediction, predict
from hw.check.rig_tolerances import STARTS, rig_tolerances
from hw.check.site_colors import SiteSpots
from hw.check.sweep_check import check_sweep
from hw.errors import CaptureError
from optimize.design.design import Array, baseline_design
from optimize.design.design_file import load_design
from optimize.design.models import open_model
from optimize.ui.console import note, print_json, reserved_stdout
from render.scene.schema import Scene, load_scene

if TYPE_CHECKING:
    from hw.cli.wiring import Wiring

FRAMES = 16
"""Photographs that are averaged for each fiber of a live sweep: ten seconds at 30 a second."""
FAULTY = 1
"""Exit code of a rig with a fault; 2 is bad input."""


def run(
    scene_name: str,
    *,
    design: Path | None,
    model: Path | None,
    capture: Path | None,
    camera: int | None,
    lens: Path | None,
    wiring: Wiring,
    bend: float,
    rig: Path | None,
    commissioned: Path | None,
    gamma: float,
    noise: float,
    as_json: bool,
) -> None:
    """Capture or read, compare, say what is wrong; the exit code is 0, or 1 with a fault.

    Arguments as on the command line; ``bend`` in degrees, ``noise`` in counts per pixel.
    """
    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        lighting = baseline_design(scene) if design is None else load_design(design, scene)
        if (capture is None) == (camera is None):
            raise CaptureError(
                "nothing to look at: give either --capture with a photograph or the folder of a "
                "sweep, or --camera with a number",
                field="capture",
            )
        checker = open_model(scene, model, threads=2)
        angle = math.radians(bend)
        prediction = predict(checker, lighting.phi, lighting.power, angle)
        spots = SiteSpots(scene, angle)
        seen: PhotoSet | Array
        if camera is not None:
            from hw.cli.capture import Shot, live

            seen = live(scene, lighting, Shot(camera, lens, frames=FRAMES), wiring)
        else:
            assert capture is not None
            seen = _read(capture, scene, gamma)
        began = time.perf_counter()
        sweep = isinstance(seen, PhotoSet)
        record = load_record(rig) if rig else None
        if record is not None:
            record.check_fits(prediction, scene.hash, angle)
        pixels = np.maximum(spots.counts, 1) * (FRAMES if camera is not None else 1)
        known = rig_tolerances(
            sweep=sweep,
            starts=0 if record is None else record.starts,
            noise=noise / np.sqrt(pixels),
        )
        ratio = None if record is None else record.ratio
        if isinstance(seen, PhotoSet):
            colors = seen.stacked(scene.fibers.count, spots.colors)
            check_order(prediction.alone.sum(axis=1), colors.sum(axis=1))
            diagnosis = check_sweep(prediction, colors, known, ratio)
            if commissioned is not None and diagnosis.ok:
                _commission(
                    commission(prediction, colors, scene.hash, angle), prediction, commissioned
                )
        else:
            if commissioned is not None:
                raise CaptureError(
                    "one photograph cannot tell fibers apart: commission with the folder of a "
                    "sweep",
                    field="commission",
                )
            colors = spots.colors(seen)
            check_order(prediction.together, colors)
            diagnosis = check_image(prediction, colors, known, ratio)
        took = time.perf_counter() - began
        if as_json:
            print_json(stream, diagnosis.to_json())
        else:
            _write(stream, diagnosis, 1e3 * took, record, sweep)
    if not diagnosis.ok:
        if commissioned is not None:
            note("No record was made of a rig with faults: mend it first.")
        raise SystemExit(FAULTY)


def _read(capture: Path, scene: Scene, gamma: float) -> PhotoSet | Array:
    rows, columns = scene.camera.rows, scene.camera.columns
    if capture.is_dir():
        return load_photo_set(capture, rows, columns, gamma)
    counts = read_photo(capture)
    check_photo(counts, rows, columns, str(capture))
    return linear(counts, gamma)


def _commission(record: RigRecord, prediction: PadPrediction, path: Path) -> None:
    """Write the record, joined with the starts that the file already holds."""
    if path.exists():
        before = load_record(path)
        before.check_fits(prediction, record.scene_hash, record.bend)
        record = before.joined(record)
    record.save(path)
    left = STARTS - record.starts
    more = f"; do this at {left} more starts of the healthy rig, to average its drift"
    note(
        f"The record in {path} holds {record.starts} start{'s' * (record.starts > 1)} of the rig: "
        f"give it to later checks with --rig{more if left > 0 else ''}."
    )


def _write(
    stream: IO[str],
    diagnosis: Diagnosis,
    milliseconds: float,
    record: RigRecord | None,
    sweep: bool,
) -> None:
    if diagnosis.ok:
        stream.write("The rig looks as designed.\n")
    if (
        all(fiber.state is FiberState.UNCLEAR for fiber in diagnosis.faults)
        and len(diagnosis.faults) > 1
    ):
        stream.write(
            f"{len(diagnosis.faults)} fibers differ in a way that no single fault explains: clean "
            "the pad and the lens, and see that scene, design and bend are those of the rig.\n"
        )
    else:
        for fiber in diagnosis.faults:
            detail = f", {fiber.detail}" if fiber.detail else ""
            stream.write(
                f"Fiber {fiber.index} {WORDS[fiber.state]}{detail} "
                f"(confidence {100 * fiber.confidence:.1f} %)\n"
            )
    stream.write(
        f"Colors differ from the prediction by {diagnosis.counts_error:.2f} counts (rms); the "
        f"check took {milliseconds:.0f} ms.\n"
    )
    stream.write(_reach(record, sweep))
    if diagnosis.domain_excess > 0:
        stream.write("The design lies outside the model's trained range: do not rely on this.\n")


def _reach(record: RigRecord | None, sweep: bool) -> str:
    """Return what this way of checking can find; `tactilux hw recall` measures it."""
    if record is None and sweep:
        return (
            "Compared with the model alone, which finds dead, dim and swapped fibers; one turned "
            "by 10 deg shows only against a record of the healthy rig (--commission, then --rig).\n"
        )
    if record is None:
        return (
            "One image compared with the model alone finds most dead and swapped fibers, few dim "
            "ones and none turned: give a sweep, and a record of the healthy rig.\n"
        )
    if not sweep:
        return "One image finds dead, dim and swapped fibers, not turned ones: give a sweep.\n"
    if record.starts < STARTS:
        return (
            f"The record holds {record.starts} of {STARTS} starts: fibers turned by 10 deg are "
            "found more surely once it holds all (--commission at a healthy start).\n"
        )
    return ""
