"""``tactilux check``: does the rig look as its design says?

Imports numpy, onnxruntime and what reads files; OpenCV and pyserial only for a live camera.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import Option

from hw.cli.capture import live
from hw.cli.options import Calibrated, Photographs, Wiring, grouped
from hw.errors import CaptureError
from optimize.cli.options import (
    Bend,
    DesignOption,
    Json,
    ModelFolder,
    SceneName,
    StateName,
    in_pose,
)
from optimize.ui.console import counted, note, print_json, reserved_stdout

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hw.check.bands import Bands
    from hw.check.commission import RigRecord
    from hw.check.diagnosis import Diagnosis
    from hw.check.prediction import PadPrediction
    from render.scene import Scene

FRAMES = 16
"""Photographs that are averaged for each fiber of a live sweep: ten seconds at 30 a second."""
FAULTY = 1
"""Exit code of a rig with a fault; 2 is bad input."""


@dataclass(frozen=True)
class KnownRig:
    """What is known of the rig beside its design, as the options of the command line say."""

    rig: Annotated[Path | None, Option(help="Record of the healthy rig, for finer checks.")] = None
    commissioned: Annotated[
        Path | None, Option("--commission", help="Write such a record from this sweep.")
    ] = None
    calibration: Calibrated = None


@grouped
def run(
    scene_name: SceneName = "finger20",
    design: DesignOption = None,
    capture: Annotated[
        Path | None, Option(help="Photograph with all fibers lit, or the folder of a sweep.")
    ] = None,
    camera: Annotated[int | None, Option(min=0, help="Number of a live camera.")] = None,
    bend: Bend = 0.0,
    state: StateName = None,
    model: ModelFolder = None,
    *,
    photographs: Photographs,
    known_rig: KnownRig,
    wiring: Wiring,
    as_json: Json = False,
) -> None:
    """Say whether the rig looks as designed (exit code 1: a fault)."""
    import numpy as np

    from hw.calibrated_powers import calibrated_powers
    from hw.check.check_rig import KnownHealth, check_rig
    from hw.check.commission import commission, load_record
    from hw.check.prediction import SiteSpots, predict
    from optimize.design import baseline_design, load_design
    from optimize.scoring import open_model
    from render.scene import load_scene

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        posed, angle, number, _ = in_pose(scene, state, bend)
        lighting = baseline_design(scene) if design is None else load_design(design, scene)
        _one_source(capture, camera)
        checker = open_model(scene, model, threads=2)
        prediction = predict(checker, lighting.phi, lighting.drive, number, scene.palette.matrix)
        spots = SiteSpots(posed, angle)
        if capture is not None:
            seen = photographs.seen(scene, capture)
        else:
            assert camera is not None
            seen = live(scene, lighting, camera, wiring, photographs.lens, FRAMES)
        began = time.perf_counter()
        commissioned = known_rig.commissioned
        if commissioned is not None and not seen.alone:
            raise CaptureError(
                "one photograph cannot tell fibers apart: commission with the folder of a sweep",
                field="commission",
            )
        record = load_record(known_rig.rig) if known_rig.rig else None
        if record is not None:
            record.check_fits(prediction, scene, number)
        beside = design or (Path(scene_name) if Path(scene_name).is_file() else None)
        powers = calibrated_powers(known_rig.calibration, beside, scene.hash, scene.lamp_count)
        if record is None and powers is not None:
            note(f"The fibers' powers are those of {powers.path}.")
        pixels = np.maximum(spots.counts, 1) * (FRAMES if camera is not None else 1)
        noise = seen.noise(photographs.noise, pixels)
        found = check_rig(scene, prediction, seen, spots, noise, KnownHealth(record, powers))
        diagnosis = found.diagnosis
        if commissioned is not None and diagnosis.ok:
            healthy = commission(found.prediction, found.colors, scene, number)
            _commission(healthy, found.prediction, scene, commissioned)
        took = time.perf_counter() - began
        if as_json:
            print_json(stream, diagnosis.to_json())
        else:
            _write(stream, diagnosis, 1e3 * took, record, bool(seen.alone), scene.state_word)
            if diagnosis.bands:
                stream.write(bands_sentence(diagnosis.bands, scene.camera.exposure_time))
    if not diagnosis.ok:
        if commissioned is not None:
            note("No record was made of a rig with faults: mend it first.")
        raise SystemExit(FAULTY)


def _one_source(capture: Path | None, camera: int | None) -> None:
    """Refuse nothing to look at, and two things."""
    if (capture is None) == (camera is None):
        problem = "nothing to look at" if camera is None else "two things to look at"
        raise CaptureError(
            f"{problem}: give either --capture with a photograph or the folder of a sweep, or "
            "--camera with a number",
            field="capture",
        )


def _commission(record: RigRecord, prediction: PadPrediction, scene: Scene, path: Path) -> None:
    """Write the record, joined with the starts that the file already holds."""
    from hw.check.commission import load_record
    from hw.check.rig_tolerances import STARTS

    if path.exists():
        before = load_record(path)
        before.check_fits(prediction, scene, record.bend)
        record = before.joined(record)
    record.save(path)
    missing = STARTS - record.starts
    more = f"; do this at {missing} more starts of the healthy rig, to average its drift"
    note(
        f"The record in {path} holds {record.starts} start{'s' * (record.starts > 1)} of the rig: "
        f"give it to later checks with --rig{more if missing > 0 else ''}."
    )


def _write(
    stream: IO[str],
    diagnosis: Diagnosis,
    milliseconds: float,
    record: RigRecord | None,
    sweep: bool,
    word: str,
) -> None:
    from hw.check.diagnosis import WORDS, FiberState

    if diagnosis.ok:
        stream.write("The rig looks as designed.\n")
    faults = diagnosis.faults
    settings = f"scene, design and {word}" if word else "scene and design"
    if all(fiber.state is FiberState.UNCLEAR for fiber in faults) and len(faults) > 1:
        stream.write(
            f"{len(faults)} fibers differ in a way that no single fault explains: clean "
            f"the pad and the lens, and see that {settings} are those of the rig.\n"
        )
    else:
        for fiber in faults:
            detail = f", {fiber.detail}" if fiber.detail else ""
            stream.write(
                f"Fiber {fiber.index} {WORDS[fiber.state]}{detail} "
                f"(confidence {100 * fiber.confidence:.1f} %)\n"
            )
    if diagnosis.unlit:
        stream.write(f"{diagnosis.unlit}\n")
    stream.write(
        f"Colors differ from the prediction by {diagnosis.counts_error:.2f} counts (rms); the "
        f"check took {milliseconds:.0f} ms.\n"
    )
    stream.write(_reach(record, sweep))
    if diagnosis.domain_excess > 0:
        stream.write("The design lies outside the model's trained range: do not rely on this.\n")


def bands_sentence(bands: Sequence[Bands], exposure_time: float | None) -> str:
    """Return what is said of ``bands`` at an exposure of so many ms, the largest ones by number."""
    from optimize.mounting import whole_periods

    worst = max(bands, key=lambda one: one.contrast)
    steady = whole_periods(exposure_time or 0.0, worst.hertz)
    return (
        f"{counted(len(bands), 'photograph')} with bands, as {worst.part} makes them where it dims "
        f"by pulses of {worst.hertz:g} Hz: {worst.photograph} differs by {worst.contrast:.0%} "
        f"every {worst.rows:.3g} rows. Expose for {steady:.4g} ms, whole periods, or light it "
        "fully.\n"
    )


def _reach(record: RigRecord | None, sweep: bool) -> str:
    """Return what this way of checking can find, as measured on random rigs."""
    from hw.check.rig_tolerances import STARTS

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
