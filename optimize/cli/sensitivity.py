"""``tactilux sensitivity``: which tolerance costs a design the most."""

from __future__ import annotations

from typing import Annotated

from typer import Option

from optimize.cli.options import Json, ModelFolder, RatedDesignArgument, Seed
from optimize.objectives import ObjectiveName
from optimize.ui.console import ProgressBar, note, print_json, reserved_stdout
from render.errors import DesignError

RENDER_SEED = 600


def run(
    path: RatedDesignArgument,
    scene: Annotated[
        str | None, Option(help="Scene file with the tolerances, where it is not shipped.")
    ] = None,
    model: ModelFolder = None,
    samples: Annotated[
        int | None,
        Option(min=1, help="Check the slopes on renders with so many samples per cell."),
    ] = None,
    objective: Annotated[
        ObjectiveName | None,
        Option(help="Whose loss: a reader's degrees (sensor, unless --samples), or S (score)."),
    ] = None,
    seed: Seed = 0,
    as_json: Json = False,
) -> None:
    """Say which manufacturing tolerance costs a design the most."""
    from optimize.design import limits_of, open_rated
    from optimize.readers import merit_of
    from optimize.robust import (
        check_slopes,
        exact_slopes,
        material_slopes,
        print_sensitivities,
        sensitivities,
        tolerances_of,
        usual_tolerances_note,
    )
    from optimize.scoring import TableScorer, model_of_design, search_table

    with reserved_stdout() as stream:
        if samples is not None and objective not in {None, "score"}:
            raise DesignError(
                f"--objective = {objective} with --samples, which checks slopes of S, allowed: "
                "score; leave one of them out",
                field="objective",
            )
        goal = objective or ("sensor" if samples is None else "score")
        candidate = open_rated(path, scene)
        sensor = candidate.scene
        spreads = tolerances_of(sensor)
        for told in usual_tolerances_note(sensor):
            note(told)
        checker = model_of_design(candidate, model, path)
        table = search_table(checker)
        scorer = TableScorer(table, limits=limits_of(sensor))
        with ProgressBar("Previews of other materials") as bar:
            slopes = material_slopes(sensor, spreads, table.phi, bar)
        merit = merit_of(goal, scorer, sensor)
        found = tuple(sensitivities(merit, candidate.design, spreads, slopes, seed=seed))
        result: dict[str, object] = {
            "scene_hash": sensor.hash,
            "objective": goal,
            "score": scorer.score(candidate.design.phi, candidate.design.power),
            "sensitivities": [entry.to_json() for entry in found],
        }
        lines = []
        if samples is not None:
            from render.reference import ensure_llvm

            ensure_llvm()
            exact = exact_slopes(merit, candidate.design, list(spreads), slopes)
            checkpoint = path.parent / f"{path.stem}-renders"
            note(f"Rendering neighbors; interrupted, the same command goes on from {checkpoint}")
            with ProgressBar("Rendering") as bar:
                checked = check_slopes(
                    candidate,
                    {name: float(values.sum()) for name, values in exact.items()},
                    samples=samples,
                    seed=RENDER_SEED + seed,
                    checkpoint=checkpoint,
                    progress=bar,
                )
            result["checked"] = [entry.to_json() for entry in checked]
            lines = [entry.sentence for entry in checked]
        if as_json:
            print_json(stream, result)
        else:
            print_sensitivities(stream, found, goal)
            stream.write("".join(f"{line}\n" for line in lines))
