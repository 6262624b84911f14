"""The command line of design and verification: one module per command, named like it.

The ``run`` of such a module is the command: its signature declares the options, and what it needs
is imported in its body, so that ``--help`` and mistyped options are answered at once.
"""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from optimize.cli import (
    colors,
    describe,
    explore,
    frontier,
    optimize,
    overnight,
    reconstruct,
    render,
    report,
    sensitivity,
    status,
    train,
    verify,
)
from render.errors import TactiluxError

PACKAGES = {
    "explore": ("cma", "glcontext", "jinja2", "matplotlib", "moderngl", "numba", "scipy"),
    "train": ("dask", "distributed", "drjit", "mitsuba", "onnx", "onnxscript", "sklearn", "torch",
              "trimesh"),
    "hw": ("cv2", "serial"),
}  # fmt: skip
"""What the extras of pyproject.toml install, by the names that are imported."""

app = typer.Typer(
    name="tactilux",
    help="Choose and verify the lights of a vision-based tactile sensor.",
    no_args_is_help=True,
    add_completion=False,
    # Plain help and plain tracebacks: rich would double the time that --help takes.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.command("explore")(explore.run)
app.command("verify")(verify.run)
app.command("optimize")(optimize.run)
app.command("sensitivity")(sensitivity.run)
app.command("reconstruct")(reconstruct.run)
app.command("train")(train.run)
app.command("frontier")(frontier.run)
app.command("overnight")(overnight.run)
app.command("status")(status.run)
app.command("render")(render.run)
app.command("describe")(describe.run)
app.command("report")(report.run)
app.command("colors")(colors.run)


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


def main() -> None:
    """Run the program; what a user can mend is one sentence on stderr and exit code 2."""
    try:
        app()
    except TactiluxError as error:
        print(f"tactilux: {error}", file=sys.stderr)
        sys.exit(2)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        extra = next((name for name, packages in PACKAGES.items() if package in packages), None)
        if extra is None:
            raise
        print(
            f"tactilux: this command needs {package}, which is not installed: in the folder of "
            f'tactilux\'s sources run: pip install ".[{extra}]"',
            file=sys.stderr,
        )
        sys.exit(2)
