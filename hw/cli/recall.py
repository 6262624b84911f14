"""``tactilux hw recall``: how many faults the check finds, on random rigs."""

from __future__ import annotations

import math
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from hw.cli.options import SceneOption
from optimize.cli.options import Json, ModelFolder, Seed
from optimize.ui.console import ProgressBar, print_json, reserved_stdout
from render.errors import TableError

if TYPE_CHECKING:
    from render.arrays import Array
    from surrogate.runtime import Checker


def run(
    scene_name: SceneOption = "finger20",
    model: ModelFolder = None,
    rigs: Annotated[int, Option(min=1, help="Number of random rigs.")] = 500,
    seed: Seed = 0,
    truth: Annotated[
        Path | None, Option(help="Transport table that stands for the true light.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Measure how many faults the check finds on random rigs."""
    import numpy as np

    from hw.check.prediction import predict
    from hw.check.rig_tolerances import STARTS
    from hw.studies.recall import MAX_FALSE_ALARMS, MIN_RECALL, RigSpread, measure_recall
    from optimize.design import baseline_design
    from optimize.scoring import open_model
    from render.geometry import flat_sites
    from render.scene import load_scene

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        checker = open_model(scene, model, threads=2)
        design = baseline_design(scene)
        prediction = predict(checker, design.phi, design.power, 0.0)
        light = None if truth is None else _true_light(truth, prediction.nodes, checker)
        began = time.monotonic()
        with ProgressBar("Rigs") as bar:
            found = measure_recall(
                prediction,
                flat_sites(scene)[:, :2],
                rigs=rigs,
                seed=seed,
                truth=light,
                progress=bar,
            )
        seconds = time.monotonic() - began
        if as_json:
            ways = [asdict(one) | {"keeps_bound": one.keeps_bound} for one in found]
            conditions = asdict(RigSpread()) | {"starts": STARTS}
            print_json(stream, {"ways": ways, "conditions": conditions, "seconds": seconds})
            return
        spread = RigSpread()
        stream.write(
            f"{rigs} random rigs of {scene.name}, one fault of each kind in each.\n"
            f"As built: powers {100 * spread.power:g} %, directions "
            f"{np.degrees(spread.turn):g} deg, smooth error of the model {100 * spread.model:g} %; "
            f"between two starts: powers {100 * spread.power_drift:g} %, directions "
            f"{np.degrees(spread.turn_drift):g} deg, single sites {100 * spread.shift:g} %.\n"
            f"Noise {spread.pixel_noise:g} counts per pixel, {spread.frames} photographs per "
            f"fiber; commissioned: against a record of {STARTS} healthy starts.\n"
        )
        for one in found:
            stream.write(
                f"{one.way}: {'keeps' if one.keeps_bound else 'misses'} the bound "
                f"({100 * MIN_RECALL:g} % found at {100 * MAX_FALSE_ALARMS:g} % false alarms)\n"
            )
            for fault, part in one.found.items():
                stream.write(
                    f"  {fault:<12} found {_percent(part, rigs)}, named rightly "
                    f"{_percent(one.named[fault], rigs)}\n"
                )
            stream.write(
                f"  false alarms {_percent(one.false_alarms, rigs)} of healthy rigs; a healthy "
                f"fiber blamed in {_percent(one.blamed, 4 * rigs)} of faulty ones\n"
            )


def _true_light(path: Path, nodes: Array, checker: Checker) -> Array:
    """Return the background of a table at bend 0 in counts, ``(fiber, node, site)``."""
    import numpy as np

    from render.chebyshev import interpolation_weights
    from render.transport import load_table

    table = load_table(path)
    flat = np.nonzero(np.abs(table.bends) < 1e-9)[0]
    if table.background is None or not len(flat):
        raise TableError(
            f"{path} holds no background at bend 0: give a table that `tactilux train` rendered",
            field="truth",
            value=str(path),
        )
    weights = interpolation_weights(table.phi, nodes)
    light = np.einsum("nj,fjs->fns", weights, table.background[:, :, flat[0]])
    return np.asarray(np.maximum(light, 1e-4 * light.max()) * checker.exposure)


def _percent(part: float, count: int) -> str:
    """Return a percentage with its 95 % interval (Wilson 1927)."""
    from optimize.scoring import normal_factor

    z = normal_factor()
    middle = (part + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * math.sqrt(part * (1 - part) / count + (z / (2 * count)) ** 2)
    return f"{100 * part:5.1f} % ({100 * (middle - half):.1f} to {100 * (middle + half):.1f})"
