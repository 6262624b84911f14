"""``tactilux hw recovery``: how well calibration recovers rigs, on rendered photographs."""

from __future__ import annotations

from dataclasses import asdict
from typing import IO, TYPE_CHECKING, Annotated

from typer import Option

from hw.cli.options import Materials, Samples, SceneOption
from optimize.cli.options import Json, ModelFolder
from optimize.ui.console import ProgressBar, print_json, reserved_stdout

if TYPE_CHECKING:
    from hw.studies.recovery import Recovered, RigOutcome


def run(
    scene_name: SceneOption = "finger20",
    model: ModelFolder = None,
    rigs: Annotated[int, Option(min=1, help="Number of random rigs.")] = 5,
    seed: Annotated[int, Option(min=0, help="Of the first rig; the others follow.")] = 0,
    rig_samples: Annotated[
        int, Option(min=1, help="Light paths per fiber and cell of the photographs.")
    ] = 8000,
    materials: Materials = 32,
    samples: Samples = 1000,
    as_json: Json = False,
) -> None:
    """Measure how well calibration recovers random rigs."""
    from hw.calibration.line_model import line_model
    from hw.emulator.session import BENDS
    from hw.studies.recovery import recover
    from optimize.design import baseline_design
    from optimize.scoring import open_model
    from render.scene import load_scene

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        checker = open_model(scene, model, threads=2)
        design = baseline_design(scene)
        with ProgressBar("Drawing materials") as bar:
            lines = line_model(scene, checker, design.phi, BENDS, bar)
        outcomes = []
        for number in range(seed, seed + rigs):
            with ProgressBar("Rendering") as bar:
                outcomes.append(
                    recover(
                        scene,
                        design,
                        lines,
                        number,
                        rig_samples=rig_samples,
                        materials=materials,
                        samples=samples,
                        progress=bar,
                    )
                )
            if not as_json:
                _write_rig(stream, outcomes[-1])
        if as_json:
            print_json(stream, {"rigs": [_as_json(one) for one in outcomes]})
        else:
            _write_sum(stream, outcomes)


def _write_rig(stream: IO[str], outcome: RigOutcome) -> None:
    stream.write(f"rig {outcome.seed}\n")
    for first, last in zip(outcome.surrogate, outcome.rendered, strict=True):
        low, high = last.interval
        stream.write(
            f"  {last.name:<20} true {last.true:8.4g}  found {last.found:8.4g} "
            f"({100 * last.error:+6.1f} %, {low:.4g} to {high:.4g}: "
            f"{'inside' if last.inside else 'outside'})  surrogate alone {100 * first.error:+6.1f} "
            f"%, {'inside' if first.inside else 'outside'}\n"
        )
    told = outcome.confirmation
    stream.write(
        f"  photographs against the last render: {100 * told.rms:.1f} % rms, explained "
        f"{100 * told.noise:.1f} %, before calibration {100 * told.before:.1f} %; "
        f"{told.renders} renders, {told.seconds:.0f} s\n"
    )
    if outcome.refused:
        stream.write("  refused: the fit ended beyond the known range of materials\n")
    stream.flush()


def _write_sum(stream: IO[str], outcomes: list[RigOutcome]) -> None:
    from hw.studies.recovery import BOUND, BOUNDED

    for way in ("surrogate", "rendered"):
        for name in BOUNDED:
            rows = [_row(getattr(one, way), name) for one in outcomes]
            stream.write(
                f"{way:<10} {name:<20} within {100 * BOUND:.0f} % or inside its interval: "
                f"{sum(row.good for row in rows)} of {len(rows)} "
                f"(inside {sum(row.inside for row in rows)}, largest error "
                f"{100 * max(abs(row.error) for row in rows):.1f} %)\n"
            )


def _row(rows: tuple[Recovered, ...], name: str) -> Recovered:
    return next(row for row in rows if row.name == name)


def _as_json(outcome: RigOutcome) -> dict[str, object]:
    return {
        "seed": outcome.seed,
        **{
            way: [
                {**asdict(row), "error": row.error, "inside": row.inside, "good": row.good}
                for row in getattr(outcome, way)
            ]
            for way in ("surrogate", "rendered")
        },
        "confirmation": asdict(outcome.confirmation),
        "refused": outcome.refused,
    }
