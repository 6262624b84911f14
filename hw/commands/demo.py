"""``tactilux hw demo``: set, sweep, check and calibrate on an emulated rig, end to end.

Everything but the hardware is real: the serial driver talks to a pseudo-terminal, photographs go
through the same readers, and the rig's true values are known to the emulated camera alone.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from hw.boards.ports import ProtocolName, open_board
from hw.calibration.material import NAMES, UNITS
from hw.channels import ChannelMap, PowerLimits
from hw.check.commission import commission
from hw.check.prediction import predict
from hw.check.sweep_check import check_sweep
from hw.check.tolerances import WAYS
from hw.check.verdict import WORDS, Verdict
from hw.commands.calibrate import calibrate_sets, print_calibration
from hw.correction import surrogate_correction
from hw.emulated.board import EmulatedBoard
from hw.emulated.camera import EmulatedCamera
from hw.emulated.rig import RAYS, Secret, camera_of, random_secret, true_images
from hw.lights import Lights, interruptible, sweep
from hw.photo_set import PhotoSet, photo_set, take_sweep
from hw.self_test import self_test
from hw.site_colours import SiteSpots
from optimize.console import Meter, note, print_json, reserved_stdout
from optimize.design import Array, Design, baseline_design
from optimize.models import find_model, open_model
from optimize.output import check_target
from render.scene import Scene, load_scene
from surrogate.checker import Checker

BENDS = np.array([0.0, np.pi / 2])
ADDITIVE_SCALE = 0.15
"""Power of the sweep that tests linearity: all fibers together must not clip."""
FRAMES = 4
WHITE = np.ones(3)
SUPPLY = PowerLimits(total_milliamperes=2000.0)


@dataclass(eq=False)
class EmulatedRig:
    """An emulated rig, switched on."""

    scene: Scene
    design: Design
    secret: Secret
    images: NDArray[np.float32]
    board: EmulatedBoard
    lights: Lights

    def camera(self, bend: int = 0, secret: Secret | None = None) -> EmulatedCamera:
        """Return the camera at a bend's index, with a fault where a changed ``secret`` has one."""
        return camera_of(self.scene, secret or self.secret, self.images[bend], self.board)

    def photos(
        self, camera: EmulatedCamera, power: Array, *, frames: int = 1, together: bool = False
    ) -> PhotoSet:
        """Return a sweep."""
        taken = take_sweep(camera, self.lights, power, frames=frames, settle=0.0, together=together)
        return photo_set(taken)


def run(
    scene_name: str,
    *,
    out: Path | None,
    model: Path | None,
    seed: int,
    mutations: int,
    rays: int = RAYS,
    calibrate: bool = True,
    as_json: bool,
) -> None:
    """Play all steps on the rig of ``seed`` and tell what came out."""
    with reserved_stdout() as stream, interruptible():
        scene = load_scene(scene_name)
        target = out or Path("runs") / f"{scene.name}-demo"
        check_target(target)
        folder = find_model(scene.name, model)
        checker = open_model(scene, folder, threads=2)
        design = baseline_design(scene)
        note("Making a rig with secrets: material, powers, directions, camera")
        secret = random_secret(scene, seed)
        bends = BENDS if calibrate else BENDS[:1]
        correction = surrogate_correction(scene, checker, design.phi, bends)
        images = true_images(scene, secret, design.phi, bends, correction=correction, rays=rays)
        secret = replace(secret, gain=_single_exposure(secret, images))
        with (
            tempfile.TemporaryDirectory() as place,
            EmulatedBoard(Path(place) / "ttyEMU0", leds=scene.fibers.count) as board,
        ):
            connect = partial(
                open_board, str(board.port), ProtocolName.LINES, leds=scene.fibers.count
            )
            channels = ChannelMap.straight(scene.fibers.count)
            with Lights(connect, channels, SUPPLY) as lights:
                rig = EmulatedRig(scene, design, secret, images, board, lights)
                _set_and_sweep(rig)
                checks = _checks(rig, checker)
                sets, additive = _photographs(rig) if calibrate else ([], None)
            if board.levels.any():
                raise AssertionError("an LED stayed on")
        result: dict[str, object] = {}
        if additive is not None:
            result = calibrate_sets(
                scene_name,
                sets,
                BENDS,
                linearity_sets=[additive],
                design=None,
                model=model,
                target=target,
                noise=secret.flaws.noise,
                mutations=mutations,
            )
            result["truth"] = _compared(result, secret)
        result["checks"] = {name: verdict.to_json() for name, verdict in checks.items()}
        if as_json:
            print_json(stream, result)
        else:
            _write(stream, checks, result)


def _single_exposure(secret: Secret, images: NDArray[np.float32]) -> float:
    """Return the exposure at which the brightest photograph of one fiber reaches 210 counts."""
    light = images * secret.power[:, None, None] * max(secret.flaws.gain)
    return 210.0 / float(np.percentile(light, 99.9, axis=(2, 3)).max())


def _set_and_sweep(rig: EmulatedRig) -> None:
    note(f"Emulated LED board on {rig.board.port}; setting the design, then sweeping")
    rig.lights.set(rig.design.power)
    if not rig.board.wait_for((255 * rig.design.power).astype(np.uint8)):
        raise AssertionError("the board does not show the design")
    lit = list(sweep(rig.lights, rig.design.power))
    self_test(rig.camera(), rig.lights, ADDITIVE_SCALE, 0.0)
    note(f"  {len(lit)} fibers lit one after the other; dark frame and channel order are right")


def _checks(rig: EmulatedRig, checker: Checker) -> dict[str, Verdict]:
    """Commission the rig, check it, then check it with one fault of each kind."""
    spots = SiteSpots(rig.scene, 0.0)
    prediction = predict(checker, rig.design.phi, rig.design.power, 0.0)
    noise = rig.secret.flaws.noise / np.sqrt(spots.counts * FRAMES)
    tolerances = replace(WAYS[True, True], noise=1.2 * noise)

    def colours(camera: EmulatedCamera, power: Array) -> Array:
        photos = rig.photos(camera, power, frames=FRAMES)
        return photos.stacked(len(rig.design.phi), spots.colours)

    healthy = colours(rig.camera(), rig.design.power)
    record = commission(prediction, healthy, rig.scene.hash, 0.0)
    found = {}
    with Meter("Checking") as meter:
        for number, (name, camera, power) in enumerate(_faulty(rig)):
            found[name] = check_sweep(prediction, colours(camera, power), tolerances, record.ratio)
            meter(number + 1, 4)
    return found


def _faulty(rig: EmulatedRig) -> list[tuple[str, EmulatedCamera, Array]]:
    def weaker(fiber: int, factor: float) -> EmulatedCamera:
        power = rig.secret.power.copy()
        power[fiber] *= factor
        camera = rig.camera(secret=replace(rig.secret, power=power))
        camera.seed = 1
        return camera

    swapped = rig.design.power.copy()
    swapped[12] = np.roll(swapped[12], 1)
    return [
        ("healthy", weaker(0, 1.0), rig.design.power),
        ("fiber 4 dead", weaker(4, 0.0), rig.design.power),
        ("fiber 9 at half power", weaker(9, 0.5), rig.design.power),
        ("fiber 12 with swapped colours", weaker(0, 1.0), swapped),
    ]


def _photographs(rig: EmulatedRig) -> tuple[list[PhotoSet], PhotoSet]:
    """Return 20 photographs, every other fiber flat and the others bent, and a linearity sweep."""
    note("Photographing every fiber in white, half of them flat and half bent")
    white = np.tile(WHITE, (len(rig.design.phi), 1))
    flat, bent = white.copy(), white.copy()
    flat[1::2], bent[::2] = 0.0, 0.0
    sets = [rig.photos(rig.camera(0), flat), rig.photos(rig.camera(1), bent)]
    additive = rig.photos(rig.camera(0), ADDITIVE_SCALE * white, together=True)
    return sets, additive


def _compared(result: dict[str, object], secret: Secret) -> list[dict[str, object]]:
    """Return the secret beside what was found."""
    material = result["material"]
    assert isinstance(material, dict)
    rows: list[dict[str, object]] = []
    for name, unit, true in zip(NAMES, UNITS, secret.material.array(), strict=True):
        value = float(true) * (180 / np.pi if unit == "deg" else 1.0)
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


def _write(stream: IO[str], checks: dict[str, Verdict], result: dict[str, object]) -> None:
    for name, verdict in checks.items():
        said = [
            f"fiber {fiber.index} is {WORDS[fiber.state]} ({100 * fiber.confidence:.1f} %)"
            for fiber in verdict.faults
        ]
        stream.write(f"Check, {name}: {'; '.join(said) or 'the rig looks as designed'}\n")
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
