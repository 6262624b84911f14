"""``tactilux explore --vary``: what dimensions of a sensor are worth, each with its best lights."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from optimize.objectives import READERS, ObjectiveName
from optimize.placement import SearchSpace
from optimize.ui.console import ProgressBar, note, print_json, reserved_stdout
from render.errors import DesignError


def explore_dimensions(
    scene_name: str,
    vary: Sequence[str],
    *,
    lamps_follow: bool,
    space: SearchSpace,
    out: Path | None,
    coarse: bool,
    objective: ObjectiveName | None,
    seed: int,
    as_json: bool,
    refused: Sequence[str],
) -> None:
    """Answer what the dimensions of ``vary`` are worth: table, plot, page and the best sensor.

    ``space`` is what may be chosen on each sensor, ``refused`` are options that were given and do
    not go with ``--vary``.

    Raises:
        DesignError: an option does not go with ``--vary``.
        SceneError: a dimension is none of the scene's, or its values make no sensor.
    """
    from optimize.dimensions import (
        PLAN,
        Variants,
        begin_study,
        dimension_of,
        print_study_table,
        run_study,
        write_study,
    )
    from optimize.ui.output import check_target
    from render.preview.gl import create_context
    from render.scene import load_scene, standalone

    began = time.monotonic()
    with reserved_stdout() as stream:
        if refused:
            raise DesignError(
                f"{refused[0]} does not go with --vary, which makes a model of every sensor "
                "with the lamps that it has: leave one of them out",
                field=refused[0].removeprefix("--"),
            )
        reader = objective or "sensor"
        if reader == "score":
            raise DesignError(
                "--objective = score with --vary, which holds sensors against each other in "
                f"degrees, allowed: {', '.join(READERS)}",
                field="objective",
            )
        scene = load_scene(scene_name)
        standalone(scene)  # refuses files that cannot be kept, before any work is done
        dimensions = [dimension_of(scene, text) for text in vary]
        variants = Variants(scene, dimensions, lamps_follow=lamps_follow, space=space)
        keys = "-".join(one.key.replace(".", "-") for one in variants.dimensions)
        target = out or Path("runs") / f"{scene.name}-{keys}"
        check_target(target, PLAN)
        create_context().release()
        left_out = variants.count - len(variants)
        note(
            f"Varying {scene.name}: {len(variants):,} sensors"
            + (f"; {left_out:,} combinations make none and are left out" if left_out else "")
        )
        plan = {
            "scene": scene.name,
            "scene_hash": scene.hash,
            "vary": list(vary),
            "lamps_follow": lamps_follow,
            "place": variants.place,
            "lamps": space.lamps,
            "parts": space.parts,
            "shots": space.shots,
            "objective": reader,
            "seed": seed,
            "coarse": coarse,
        }
        folder = begin_study(target, plan)
        with ProgressBar() as bar:
            found = run_study(
                variants, reader=reader, coarse=coarse, seed=seed, folder=folder, progress=bar
            )
            bar.note("  drawing pictures and the report")
            result = write_study(target, found)
        result["seconds"] = round(time.monotonic() - began, 3)
        if as_json:
            print_json(stream, result)
        else:
            print_study_table(stream, found)
            stream.write(
                f"Scene: {result['best_scene']}\nDesign: {result['design']}\n"
                f"Report: {result['report']}\n"
            )
