"""``tactilux hw demo``: set, sweep, check and calibrate on an emulated rig, end to end."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any

from typer import Option

from hw.cli.calibrate import print_calibration
from hw.cli.options import Renders, SceneOption, grouped
from optimize.cli.options import Json, ModelFolder, Seed
from optimize.ui.console import note, print_json, reserved_stdout

if TYPE_CHECKING:
    from hw.check.diagnosis import Diagnosis

MINUTES_PER_LAMP = 2
"""Of rendering materials and the rig, on two cores: 40 on ``finger20``."""


@grouped
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
    rays: Annotated[
        int, Option(min=2000, help="Light paths of photographs that are not rendered.")
    ] = 360_000,
    keep: Annotated[
        Path | None, Option(help="Folder for the rig's photographs and design, to try others on.")
    ] = None,
    calibrate: Annotated[
        bool, Option(help="Also calibrate, on rendered photographs: half an hour and more.")
    ] = False,
    *,
    renders: Renders,
    as_json: Json = False,
) -> None:
    """Run set, sweep, check and calibrate on an emulated rig."""
    import numpy as np

    from hw.calibration.calibration import Sweeps, calibrate_sets
    from hw.calibration.line_model import surrogate_correction
    from hw.calibration.material import check_one_shot, material_space
    from hw.calibration.reference_lines import Setup
    from hw.emulator.demonstration import (
        calibration_bends,
        check_faults,
        compare_with_truth,
        render_rig,
        set_and_sweep,
        single_exposure,
        switched_on,
    )
    from hw.emulator.rig import random_parameters, true_images
    from optimize.design import baseline_design, save_design
    from optimize.scoring import open_model
    from optimize.ui.output import check_target
    from render.scene import load_scene

    with reserved_stdout() as stream:
        began = time.monotonic()
        scene = load_scene(scene_name)
        target = out or Path("runs") / f"{scene.name}-demo"
        check_target(target)
        if keep is not None:
            check_target(keep / "commission")
        if calibrate:
            check_one_shot(scene)
            material_space(scene)
        elif scene.diffuser is not None:
            # Behind it, lamps are drawn for one albedo after the other.
            material_space(scene.one_albedo_scenes[0])
        checker = open_model(scene, model, threads=2)
        design = baseline_design(scene)
        if keep is not None:
            save_design(keep / "design.json", design, scene)
        truth = random_parameters(scene, seed)
        if calibrate:
            minutes = MINUTES_PER_LAMP * scene.lamp_count
            note(
                f"With calibration this takes about {minutes} minutes on two cores the first time, "
                f"and {max(minutes // 5, 1)} from then on; without --calibrate it takes one or two"
            )
            images = render_rig(scene, truth, design, rig_samples)
        else:
            note("Making a rig with secrets: material, powers, directions, camera")
            setup = Setup(scene, design.phi, np.zeros(1))
            correction = surrogate_correction(setup, checker)
            images = true_images(setup, truth, correction=correction, rays=rays)
        truth = replace(truth, gain=single_exposure(truth, images))
        with switched_on(scene, design, truth, images, keep) as rig:
            set_and_sweep(rig)
            checks = check_faults(rig, checker)
            sweeps = None
            if calibrate:
                note("Photographing every fiber, and those of the flat pad in each LED color")
                sweeps = Sweeps(
                    by_bend=rig.calibration_sets(),
                    bends=calibration_bends(scene),
                    by_color=rig.color_sets(),
                    additive=rig.additive_set(),
                    noise=truth.imperfections.noise,
                )
            elif keep is not None:
                rig.additive_set()
        result: dict[str, Any] = {}
        if sweeps is not None:
            result = calibrate_sets(
                scene, sweeps, design=None, model=model, target=target,
                materials=renders.materials, samples=renders.samples,
            )  # fmt: skip
            result["truth"] = compare_with_truth(scene, result, truth)
        result["checks"] = {name: diagnosis.to_json() for name, diagnosis in checks.items()}
        result["seconds"] = time.monotonic() - began
        if as_json:
            print_json(stream, result)
        else:
            _write(stream, checks, result)
        if keep is not None:
            of_scene = "" if scene_name == "finger20" else f" --scene {scene_name}"
            broken = next(name for name in checks if name.endswith("dead")).replace(" ", "-")
            note(
                f"Kept in {keep}: design and sweeps, as `tactilux hw capture` writes them. Try\n"
                f"  tactilux hw linearity {keep}/additive{of_scene}\n"
                f"  tactilux check {scene_name} --capture {keep}/commission "
                f"--commission {keep}/rig.npz\n"
                f"  tactilux check {scene_name} --capture {keep}/{broken} --rig {keep}/rig.npz"
            )


def _write(stream: IO[str], checks: dict[str, Diagnosis], result: dict[str, Any]) -> None:
    from hw.check.diagnosis import WORDS

    for name, diagnosis in checks.items():
        said = [
            f"fiber {fiber.index} {WORDS[fiber.state]} ({100 * fiber.confidence:.1f} %)"
            for fiber in diagnosis.faults
        ]
        stream.write(f"Check, {name}: {'; '.join(said) or 'the rig looks as designed'}\n")
    if checks["healthy"].unlit:
        stream.write(f"{checks['healthy'].unlit}\n")
    if "truth" not in result:
        return
    print_calibration(stream, result)
    for row in result["truth"]:
        stream.write(
            f"  the rig's true {row['name']} is {row['true']:.4g}: off by "
            f"{100 * row['error']:+.1f} %, "
            f"{'inside' if row['inside'] else 'outside'} the interval\n"
        )
    stream.write(f"The demonstration took {result['seconds']:.0f} s.\n")
