"""``tactilux wiring``: what a builder needs on the bench, for one design."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from optimize.cli.options import DesignArgument, Json, ModelFolder, SceneOfDesign
from optimize.ui.console import ProgressBar, note, print_json, reserved_stdout
from render.errors import ModelError


def run(
    path: DesignArgument,
    out: Annotated[
        Path | None, Option(help="Result directory (default: <design>-wiring beside the design).")
    ] = None,
    step: Annotated[
        float | None,
        Option(min=0.0, max=90.0, help="Degrees between angles that can be mounted; 0: as found."),
    ] = None,
    leds: Annotated[
        str | None, Option(help="LED of each fiber, like 0,1,2 (default: in their order).")
    ] = None,
    order: Annotated[str, Option(help="How the LEDs' channels are wired: rgb, grb, ...")] = "rgb",
    scene: SceneOfDesign = None,
    model: ModelFolder = None,
    as_json: Json = False,
) -> None:
    """Write wiring sheet, CSV, board and jig of a design."""
    from hw.leds.channels import ChannelMap
    from optimize.design import load_layout
    from optimize.exploration import rate
    from optimize.mounting import Feeds, mount, mounting_error_costs, surrogate_score
    from optimize.report import render_page, wiring_context, wiring_files, write_wiring
    from optimize.scoring import open_model
    from optimize.ui.output import check_target, fresh_directory, write_manifest
    from render.files import write_text

    with reserved_stdout() as stream:
        sensor, design = load_layout(path, scene)
        target = out or path.with_name(f"{path.stem}-wiring")
        check_target(target)
        channels = ChannelMap.parse(leds, len(design.phi), order)
        feeds = Feeds(channels.leds, channels.order)
        errors, rating = [], None
        try:
            checker = open_model(sensor, model, design=path)
        except ModelError as error:
            if model is not None:
                raise
            note(f"Without a price of rounding and of errors in building: {error}")
            mounting = mount(sensor, design, step=step, feeds=feeds)
        else:
            mounting = mount(
                sensor, design, surrogate_score(checker, sensor), step=step, feeds=feeds
            )
            rating = rate(checker, sensor, "mounted", "As mounted", "", mounting.design).rating
            with ProgressBar("Previews of other diffusers") as bar:
                errors = mounting_error_costs(
                    checker, sensor, mounting.design, layer=True, progress=bar
                )
        with fresh_directory(target) as folder:
            no_jig = write_wiring(folder, mounting, rating)
            sheet = wiring_context(
                mounting,
                str(path),
                errors,
                wiring_files(path, no_jig),
                None if rating is None else rating.read,
            )
            facts = [("Scene", f"{sensor.name}, {sensor.hash}"), ("Design", str(path))]
            page = {"scene": sensor.name, "scene_hash": sensor.hash, "bends": [0.0], "facts": facts}
            write_text(
                folder / "wiring.html", render_page("wiring.html.j2", {**page, "wiring": sheet})
            )
            result: dict[str, object] = {
                "scene_hash": sensor.hash,
                "step_deg": mounting.step,
                "score_found": mounting.score_found,
                "score": mounting.score,
                "milliamperes": mounting.current,
                "us_dollars": mounting.price,
                "problems": mounting.problems,
                "jig": no_jig or str(target / "jig.stl"),
                "sheet": str(target / "wiring.html"),
            }
            write_manifest(folder, result)
        if as_json:
            print_json(stream, result)
            return
        for sentence in (*mounting.problems, *sheet["notes"]):
            stream.write(f"{sentence}\n")
        stream.write(f"Jig: {result['jig']}\nSheet: {result['sheet']}\n")
