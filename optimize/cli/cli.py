"""The command line: what can be asked, and how failures are told.

Only options are declared here. Each command's work is in ``optimize/commands`` and is imported
when it runs, so that ``--help`` stays quick.
"""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from render.errors import TactiluxError

# Packages of the extra "train", which rendering and training need, and of "hw", for the real rig.
EXTRA = dict.fromkeys(
    ("dask", "distributed", "drjit", "mitsuba", "onnx", "onnxscript", "sklearn", "torch"), "train"
)
EXTRA |= dict.fromkeys(("cv2", "serial"), "hw")

app = typer.Typer(
    name="tactilux",
    help="Choose and verify the lights of a vision-based tactile sensor.",
    no_args_is_help=True,
    add_completion=False,
    # Plain help and plain tracebacks: rich would double the time that --help takes.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


class Method(StrEnum):
    """How colors are searched."""

    GROUPED = "grouped"
    QUICK = "quick"
    EXACT = "exact"


class Robust(StrEnum):
    """What is maximized over sensors as they are built."""

    QUANTILE = "quantile"
    SPREAD = "spread"


class Procedure(StrEnum):
    """Who optimizes at level 2."""

    LOOP = "loop"
    THESIS = "thesis"
    BOTH = "both"


class Level(StrEnum):
    """Which level of the fidelity ladder draws a picture."""

    PREVIEW = "preview"
    REFERENCE = "reference"


Scene = Annotated[str, typer.Argument(help="Name of a shipped scene, or a TOML file.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Model = Annotated[
    Path | None, typer.Option(help="Folder with checker.onnx (default: models/<scene>).")
]
Design = Annotated[Path | None, typer.Option(help="A design.json (default: the baseline design).")]
DesignFile = Annotated[Path, typer.Argument(help="The design.json that explore wrote.")]
RatedDesign = Annotated[Path, typer.Argument(help="A rated design.json.")]
DesignScene = Annotated[
    str | None, typer.Option(help="Scene file, where the design's scene is not a shipped one.")
]
Bend = Annotated[float, typer.Option(min=0.0, max=180.0, help="Total bending angle in degrees.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of all random choices.")]


def _print_version(wanted: bool) -> None:
    if wanted:
        from optimize.ui.provenance import program_version

        typer.echo(f"tactilux {program_version()}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    pass


@app.command()
def explore(
    scene: Scene = "finger20",
    out: Annotated[
        Path | None, typer.Option(help="Result directory (default: runs/<scene>-explore).")
    ] = None,
    model: Model = None,
    seed: Seed = 0,
    robust: Annotated[
        Robust | None,
        typer.Option(help="Against the scene's tolerances: lower 10 % quantile, or mean - spread."),
    ] = None,
    shadow: Annotated[
        float | None, typer.Option(min=0.0, help="Weight of the penalty for a bolt's shadows.")
    ] = None,
    json: Json = False,
) -> None:
    """Find a better lighting design on the surrogate."""
    from optimize.cli import explore as command

    command.run(
        scene,
        out=out,
        model=model,
        seed=seed,
        robust=None if robust is None else robust.value,
        shadow=shadow,
        as_json=json,
    )


@app.command()
def verify(
    design: DesignFile,
    scene: DesignScene = None,
    model: Model = None,
    samples: Annotated[
        int | None, typer.Option(min=1, help="Samples per cell and seed (default: 200).")
    ] = None,
    minutes: Annotated[
        float | None, typer.Option(min=0.1, help="Rendering time, instead of --samples.")
    ] = None,
    seeds: Annotated[int, typer.Option(min=2, help="Number of independent seeds.")] = 4,
    json: Json = False,
) -> None:
    """Render design and baseline with error bars."""
    from optimize.cli import verify as command

    command.run(
        design,
        scene=scene,
        model=model,
        samples=samples,
        minutes=minutes,
        seeds=seeds,
        as_json=json,
    )


@app.command()
def optimize(
    scene: Scene = "finger20",
    method: Annotated[
        Procedure,
        typer.Option(help="Verification loop, the thesis's procedure, or both side by side."),
    ] = Procedure.LOOP,
    out: Annotated[
        Path | None, typer.Option(help="Result directory (default: runs/<scene>-optimize).")
    ] = None,
    model: Model = None,
    rounds: Annotated[int, typer.Option(min=1, help="Rounds of the loop at most.")] = 4,
    generations: Annotated[
        int, typer.Option(min=1, help="Generations of the thesis's CMA-ES at most.")
    ] = 20,
    samples: Annotated[
        int, typer.Option(min=1, help="Samples per cell of every candidate's render.")
    ] = 96,
    final_samples: Annotated[
        int, typer.Option(min=1, help="Samples per cell and seed of the finalists' renders.")
    ] = 192,
    final_seeds: Annotated[int, typer.Option(min=1, help="Seeds of the finalists' renders.")] = 2,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Search with renders deciding: propose, render, refit."""
    from optimize.cli import optimize as command

    command.run(
        scene,
        method=method.value,
        out=out,
        model=model,
        rounds=rounds,
        generations=generations,
        samples=samples,
        final_samples=final_samples,
        final_seeds=final_seeds,
        seed=seed,
        as_json=json,
    )


@app.command()
def sensitivity(
    design: RatedDesign,
    scene: Annotated[
        str | None, typer.Option(help="Scene file with the tolerances, where it is not shipped.")
    ] = None,
    model: Model = None,
    samples: Annotated[
        int | None,
        typer.Option(min=1, help="Check the slopes on renders with so many samples per cell."),
    ] = None,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Say which manufacturing tolerance costs the most score."""
    from optimize.cli import sensitivity as command

    command.run(design, scene=scene, model=model, samples=samples, seed=seed, as_json=json)


@app.command()
def reconstruct(
    design: RatedDesign,
    scene: DesignScene = None,
    model: Model = None,
    read_noise: Annotated[
        float, typer.Option(min=0.0, help="Read noise of the camera in counts.")
    ] = 1.0,
    full_well: Annotated[
        float, typer.Option(min=1.0, help="Photoelectrons at 255 counts, for the shot noise.")
    ] = 10000.0,
    samples: Annotated[
        int | None,
        typer.Option(min=1, help="Use renders with so many samples per cell instead."),
    ] = None,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Recover surface normals from the colors, in degrees."""
    from optimize.cli import reconstruct as command

    command.run(
        design,
        scene=scene,
        model=model,
        read_noise=read_noise,
        full_well=full_well,
        samples=samples,
        seed=seed,
        as_json=json,
    )


@app.command()
def train(
    scene: Scene = "finger20",
    out: Annotated[
        Path | None, typer.Option(help="Model folder (default: models/<scene>).")
    ] = None,
    minutes: Annotated[float, typer.Option(min=0.1, help="Rendering time.")] = 40.0,
    samples: Annotated[
        int | None,
        typer.Option(min=1, help="Samples per fiber and facet: the same work on any machine."),
    ] = None,
    seed: Seed = 0,
    table: Annotated[
        Path | None, typer.Option(help="Fit to this reference table instead of rendering one.")
    ] = None,
) -> None:
    """Make the surrogate: render, fit, export."""
    from optimize.cli import train as command

    command.run(scene, out=out, minutes=minutes, samples=samples, seed=seed, table=table)


@app.command()
def frontier(
    scene: Scene = "finger20",
    out: Annotated[
        Path | None, typer.Option(help="Run directory (default: runs/<scene>-frontier).")
    ] = None,
    model: Model = None,
    table: Annotated[
        Path | None,
        typer.Option(
            help="Reference table to fit to (default: models/<scene>-training/reference.npz, "
            "or a new render)."
        ),
    ] = None,
    designs: Annotated[int, typer.Option(min=2, help="Random held-out designs.")] = 30,
    minutes: Annotated[float, typer.Option(min=3.0, help="Time for everything together.")] = 30.0,
    samples: Annotated[
        int | None,
        typer.Option(
            min=32, help="Samples per cell of the reference: the same work on any machine."
        ),
    ] = None,
    seed: Seed = 0,
    json: Json = False,
) -> None:
    """Measure what every level costs and how wrong it is."""
    from optimize.cli import frontier as command

    command.run(
        scene,
        out=out,
        model=model,
        table=table,
        designs=designs,
        minutes=minutes,
        samples=samples,
        seed=seed,
        as_json=json,
    )


@app.command()
def overnight(
    scene: Scene = "finger20",
    out: Annotated[
        Path | None, typer.Option(help="Run directory (default: runs/<scene>-overnight).")
    ] = None,
    hours: Annotated[
        float | None,
        typer.Option(min=0.01, help="Time for everything, over all attempts (default: 8)."),
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(min=1, help="A fixed amount of work instead: per cell of the table."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Render in so many processes on this machine.")
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(help="Render on the workers of a Dask scheduler, tcp://host:8786."),
    ] = None,
    seed: Seed = 0,
    json: Json = False,
    json_lines: Annotated[
        bool, typer.Option("--json-lines", help="Print progress as JSON, one object per line.")
    ] = False,
) -> None:
    """Verify designs by rendering for hours; survives interruptions."""
    from optimize.cli import overnight as command

    for first, second, both in (
        ("--hours", "--samples", hours is not None and samples is not None),
        ("--workers", "--dask", workers is not None and dask is not None),
    ):
        if both:
            raise typer.BadParameter(f"give {first} or {second}, not both")
    command.run(
        scene,
        out=out,
        hours=hours,
        samples=samples,
        workers=workers,
        dask=dask,
        seed=seed,
        as_json=json,
        json_lines=json_lines,
    )


@app.command()
def status(
    run: Annotated[Path, typer.Argument(help="Directory of an overnight run.")],
    scaling: Annotated[
        bool, typer.Option("--scaling", help="Say what 2, 8 and 64 workers would do.")
    ] = False,
    hours: Annotated[
        float | None,
        typer.Option(min=0.01, help="With --scaling: for a night of so many hours instead."),
    ] = None,
    json: Json = False,
) -> None:
    """Say how far an overnight run is, also while it works."""
    from optimize.cli import status as command

    if hours is not None and not scaling:
        raise typer.BadParameter("--hours goes with --scaling")
    command.run(run, scaling=scaling, hours=hours, as_json=json)


@app.command()
def render(
    scene: Scene = "finger20",
    design: Design = None,
    bend: Bend = 0.0,
    level: Annotated[Level, typer.Option(help="Which renderer draws.")] = Level.PREVIEW,
    out: Annotated[Path | None, typer.Option(help="PNG file to write.")] = None,
) -> None:
    """Draw what the camera sees."""
    from optimize.cli import render as command

    command.run(scene, design=design, bend=bend, level=level.value, out=out)


@app.command()
def describe(scene: Scene = "finger20", json: Json = False) -> None:
    """Say what a scene models and leaves out."""
    from optimize.cli import describe as command

    command.run(scene, as_json=json)


@app.command()
def report(
    run: Annotated[Path, typer.Argument(help="The directory of a finished night.")],
) -> None:
    """Write the report of a finished night anew, from its files alone."""
    from optimize.cli import report as command

    command.run(run)


@app.command()
def colors(
    table: Annotated[Path, typer.Argument(help="Transport table, an .npz file.")],
    method: Annotated[Method, typer.Option(help="Search method.")] = Method.QUICK,
    phi_index: Annotated[
        int | None, typer.Option(help="Direction node to use, where the table has several.")
    ] = None,
    seed: Seed = 0,
    device: Annotated[
        str | None, typer.Option(help="Let torch search on this device, for example cuda.")
    ] = None,
    json: Json = False,
) -> None:
    """Search the colors of a transport table."""
    from optimize.cli import colors as command

    command.run(
        table,
        method=method.value,
        phi_index=phi_index,
        seed=seed,
        device=device,
        as_json=json,
    )


def main() -> None:
    """Run the program; what a user can mend is one sentence on stderr and exit code 2."""
    try:
        app()
    except TactiluxError as error:
        print(f"tactilux: {error}", file=sys.stderr)
        sys.exit(2)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRA:
            raise
        print(
            f"tactilux: this command needs {package}, which is not installed: "
            f"pip install 'tactilux[{EXTRA[package]}]'",
            file=sys.stderr,
        )
        sys.exit(2)


if __name__ == "__main__":
    main()
