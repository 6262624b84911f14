"""``tactilux hw demo``: set, sweep, check and calibrate on an emulated rig, end to end.

Everything but the hardware is real: the serial driver talks to a pseudo-terminal, photographs go
through the same readers, and the rig's true values are known to the emulated camera alone.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated

from typer import Option

from hw.cli.calibrate import calibrate_sets, print_calibration
from hw.cli.options import Materials, Samples, SceneOption
from optimize.cli.options import Json, ModelFolder, Seed
from optimize.ui.console import ProgressBar, note, print_json, reserved_stdout
from render.progress import Progress

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hw.camera.photo_set import PhotoSet
    from hw.check.diagnosis import Diagnosis
    from hw.emulator.emulated_camera import EmulatedCamera
    from hw.emulator.rig import TrueParameters
    from hw.emulator.session import EmulatedRig
    from optimize.design import Design
    from render.arrays import Array
    from render.scene import Scene
    from surrogate.runtime import Checker

FRAMES = 4
"""Photographs that are averaged for each fiber of the checks."""
DRIFT = 0.03
"""Relative change of powers between two starts."""
DURATION = "about 40 minutes on two cores the first time, and eight from then on"


def run(
    scene_name: SceneOption = "finger20",
    out: Annotated[
        Path | None, Option(help="Result directory (default: runs/<scene>-demo).")
    ] = None,
    model: ModelFolder = None,
    seed: Seed = 0,
    rig_samples: Annotated[
        int, Option(min=1, help="Light paths per fiber and cell of rendered photographs.")
    ] = 2000,
    materials: Materials = 32,
    samples: Samples = 1000,
    rays: Annotated[
        int, Option(min=2000, help="Light paths of photographs that are not rendered.")
    ] = 360_000,
    calibrate: Annotated[
        bool, Option(help="Also calibrate, on rendered photographs: the long part.")
    ] = True,
    as_json: Json = False,
) -> None:
    """Run set, sweep, check and calibrate on an emulated rig with secret true values."""
    from hw.calibration.line_model import surrogate_correction
    from hw.emulator.rig import random_parameters, true_images
    from hw.emulator.session import BENDS, single_exposure, switched_on
    from hw.leds.fiber_lights import interruptible
    from optimize.design import baseline_design
    from optimize.scoring import open_model
    from optimize.ui.output import check_target
    from render.scene import load_scene

    with reserved_stdout() as stream, interruptible():
        began = time.monotonic()
        scene = load_scene(scene_name)
        target = out or Path("runs") / f"{scene.name}-demo"
        check_target(target)
        checker = open_model(scene, model, threads=2)
        design = baseline_design(scene)
        truth = random_parameters(scene, seed)
        if calibrate:
            note(f"The whole demonstration takes {DURATION}; --no-calibrate leaves the long parts")
            images = _rendered(scene, truth, design, rig_samples)
        else:
            note("Making a rig with secrets: material, powers, directions, camera")
            correction = surrogate_correction(scene, checker, design.phi, BENDS[:1])
            images = true_images(
                scene, truth, design.phi, BENDS[:1], correction=correction, rays=rays
            )
        truth = replace(truth, gain=single_exposure(truth, images))
        with switched_on(scene, design, truth, images) as rig:
            _set_and_sweep(rig)
            checks = _checks(rig, checker)
            sets: list[PhotoSet] = []
            if calibrate:
                note("Photographing every fiber in white, half of them flat and half bent")
                sets, additive = rig.calibration_sets(), rig.additive_set()
        result: dict[str, object] = {}
        if calibrate:
            result = calibrate_sets(
                scene_name,
                sets,
                BENDS,
                linearity_sets=[additive],
                design=None,
                model=model,
                target=target,
                noise=truth.imperfections.noise,
                materials=materials,
                samples=samples,
            )
            result["truth"] = _compared(result, truth)
        result["checks"] = {name: diagnosis.to_json() for name, diagnosis in checks.items()}
        result["seconds"] = time.monotonic() - began
        if as_json:
            print_json(stream, result)
        else:
            _write(stream, checks, result)


def _rendered(
    scene: Scene, truth: TrueParameters, design: Design, rig_samples: int
) -> NDArray[np.float32]:
    """Return the rig's light: all fibers on the flat pad, those to be photographed on the bent."""
    from hw.emulator.rig import rendered_images
    from hw.emulator.session import BENDS, CALIBRATION_FIBERS

    note("Rendering what the camera of a rig with secrets sees: material, powers, directions")
    fibers = range(scene.fibers.count)
    with ProgressBar("Rendering the rig") as bar:
        return rendered_images(
            scene,
            truth,
            design.phi,
            BENDS,
            [fibers, fibers[CALIBRATION_FIBERS[1]]],
            samples=rig_samples,
            progress=bar,
        )


def _set_and_sweep(rig: EmulatedRig) -> None:
    import numpy as np

    from hw.camera.self_test import self_test
    from hw.emulator.session import ADDITIVE_SCALE
    from hw.leds.fiber_lights import sweep

    note(f"Emulated LED board on {rig.board.port}; setting the design, then sweeping")
    rig.lights.set(rig.design.power)
    if not rig.board.wait_for((255 * rig.design.power).astype(np.uint8)):
        raise AssertionError("the board does not show the design")
    lit = list(sweep(rig.lights, rig.design.power))
    self_test(rig.camera(), rig.lights, ADDITIVE_SCALE, 0.0)
    note(f"  {len(lit)} fibers lit one after the other; dark frame and channel order are right")


def _checks(rig: EmulatedRig, checker: Checker) -> dict[str, Diagnosis]:
    """Commission the rig, check it, then check it with one fault of each kind."""
    import numpy as np

    from hw.check.commission import commission
    from hw.check.prediction import predict
    from hw.check.rig_tolerances import rig_tolerances
    from hw.check.site_colors import SiteSpots
    from hw.check.sweep_check import check_sweep

    spots = SiteSpots(rig.scene, 0.0)
    prediction = predict(checker, rig.design.phi, rig.design.power, 0.0)
    noise = rig.truth.imperfections.noise / np.sqrt(spots.counts * FRAMES)
    known = rig_tolerances(sweep=True, starts=1, noise=noise)

    def colors(camera: EmulatedCamera, power: Array) -> Array:
        photos = rig.photos(camera, power, frames=FRAMES)
        return photos.stacked(len(rig.design.phi), spots.colors)

    healthy = colors(rig.camera(), rig.design.power)
    record = commission(prediction, healthy, rig.scene.hash, 0.0)
    found = {}
    with ProgressBar("Checking") as bar:
        for number, (name, camera, power) in enumerate(_faulty(rig)):
            found[name] = check_sweep(prediction, colors(camera, power), known, record.ratio)
            bar(Progress(number + 1, 4))
    return found


def _faulty(rig: EmulatedRig) -> list[tuple[str, EmulatedCamera, Array]]:
    """Return the rig at later starts: name, camera with drift and noise of its own, powers."""
    import numpy as np

    starts = itertools.count(1)

    def weaker(fiber: int, factor: float) -> EmulatedCamera:
        start = next(starts)
        rng = np.random.default_rng([rig.truth.seed, start])
        power = rig.truth.power * np.exp(DRIFT * rng.standard_normal(len(rig.truth.power)))
        power[fiber] *= factor
        return replace(
            rig.camera(truth=replace(rig.truth, power=power)), seed=rig.truth.seed + start
        )

    swapped = rig.design.power.copy()
    swapped[12] = np.roll(swapped[12], 1)
    return [
        ("healthy", weaker(0, 1.0), rig.design.power),
        ("fiber 4 dead", weaker(4, 0.0), rig.design.power),
        ("fiber 9 at half power", weaker(9, 0.5), rig.design.power),
        ("fiber 12 with swapped colors", weaker(0, 1.0), swapped),
    ]


def _compared(result: dict[str, object], truth: TrueParameters) -> list[dict[str, object]]:
    """Return the truth beside what was found."""
    from hw.calibration.material import NAMES, PER_UNIT

    material = result["material"]
    assert isinstance(material, dict)
    rows: list[dict[str, object]] = []
    for name, true in zip(NAMES, PER_UNIT * truth.material.array(), strict=True):
        value = float(true)
        found = material[name]
        low, high = found["interval"]
        rows.append(
            {
                "name": name,
                "true": value,
                "found": found["value"],
                "error": found["value"] / value - 1,
                "inside": bool(low <= value <= high),
            }
        )
    return rows


def _write(stream: IO[str], checks: dict[str, Diagnosis], result: dict[str, object]) -> None:
    from hw.check.diagnosis import WORDS

    for name, diagnosis in checks.items():
        said = [
            f"fiber {fiber.index} {WORDS[fiber.state]} ({100 * fiber.confidence:.1f} %)"
            for fiber in diagnosis.faults
        ]
        stream.write(f"Check, {name}: {'; '.join(said) or 'the rig looks as designed'}\n")
    stream.write(
        "A fiber turned by 10 deg is the hardest fault: `tactilux hw recall` measures it.\n"
    )
    if "truth" not in result:
        return
    print_calibration(stream, result)
    rows = result["truth"]
    assert isinstance(rows, list)
    for row in rows:
        stream.write(
            f"  the rig's true {row['name']} is {row['true']:.4g}: off by "
            f"{100 * row['error']:+.1f} %, "
            f"{'inside' if row['inside'] else 'outside'} the interval\n"
        )
    stream.write(f"The demonstration took {result['seconds']:.0f} s.\n")
