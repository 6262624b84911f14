"""``tactilux train``: make the surrogate of a scene, from renders or from a table of them."""

from __future__ import annotations

import shlex
import time
from pathlib import Path
from typing import Annotated

from typer import Option

from optimize.cli.options import MAX_MINUTES, Coarse, SceneName, Seed
from optimize.ui.console import ProgressBar, reserved_stdout


def run(
    scene_name: SceneName = "finger20",
    out: Annotated[Path | None, Option(help="Model folder (default: models/<scene>).")] = None,
    minutes: Annotated[
        float, Option(min=0.1, max=MAX_MINUTES, help="Time for everything together.")
    ] = 40.0,
    samples: Annotated[
        int | None,
        Option(min=1, help="Samples per fiber and facet: the same work on any machine."),
    ] = None,
    seed: Seed = 0,
    table: Annotated[
        Path | None, Option(help="Fit to this reference table instead of rendering one.")
    ] = None,
    coarse: Coarse = False,
) -> None:
    """Make the surrogate: render, fit, export."""
    began = time.monotonic()
    from render.reference import ensure_llvm
    from render.scene import load_scene
    from render.transport import load_table
    from surrogate.export.model_card import unproven_interval
    from surrogate.export.package import check_replaceable
    from surrogate.runtime import RankingTest
    from surrogate.runtime.metadata import NONE
    from surrogate.train import TrainConfig, train

    with reserved_stdout() as stream:
        scene = load_scene(scene_name)
        folder = out or Path("models") / scene.name
        check_replaceable(folder)
        known = None if table is None else load_table(table)
        if known is None:
            ensure_llvm()
        command = ["tactilux", "train", scene_name, "--seed", str(seed)]
        if table is not None:
            command += ["--table", table.name]
        elif samples is not None:
            command += ["--samples", str(samples)]
        else:
            command += ["--minutes", f"{minutes:g}"]
        if coarse:
            command.append("--coarse")
        with ProgressBar(announce=True) as bar:
            made = train(
                scene,
                folder,
                seed=seed,
                table=known,
                config=TrainConfig(minutes=minutes, samples=samples, coarse=coarse),
                command=shlex.join(command),
                began=began,
                progress=bar,
            )
        stream.write(
            f"{'held-out errors':<24}{'color, median':>15}{'score, median':>15}{'tau':>7}\n"
        )
        for row in made.metadata.held_out:
            stream.write(
                f"{row['name']:<24}{row['facet_median']:>15.2%}{row['score_median']:>15.3f}"
                f"{row['kendall_tau']:>7.2f}\n"
            )
        about = made.metadata
        stream.write(
            f"Scale: exposure {about.exposure:.6g}, lambda {about.lam:.5g}, from the preview; "
            f"in the renders the baseline reaches {made.baseline_counts:.0f} counts instead of "
            f"{about.metric.exposure_counts:g}.\n"
        )
        kind, unproven = about.residual["kind"], unproven_interval(about)
        if kind == NONE:
            check = (
                ""
                if unproven
                else ", and the renders are its check. Several times the samples may find what it "
                "misses"
            )
            stream.write(
                f"Note: the renders bear out no correction: the model is the {about.preview_name}"
                f"{check}.\n"
            )
        if unproven:
            stream.write(f"Note: {unproven}\n")
        advice = RankingTest.of(about).advice()
        if advice:
            stream.write(f"Note: {advice}\n")
        stream.write(
            f"Model: {made.folder}, {about.preview_name}, residual: {kind}, {made.seconds:.0f} s\n"
        )
