"""The command line of design and verification: one module per command, named like it.

The ``run`` of such a module is the command: its signature declares the options, and what it needs
is imported in its body, so that ``--help`` and mistyped options are answered at once.
"""

from __future__ import annotations

import errno
import os
import re
import sys
from typing import Annotated, NoReturn

import typer

from optimize.cli import (
    colors,
    compare,
    describe,
    explore,
    frontier,
    new,
    optimize,
    overnight,
    play,
    reconstruct,
    render,
    report,
    runs,
    schema,
    score,
    sensitivity,
    status,
    train,
    verify,
)
from optimize.ui.command import Command
from optimize.ui.process import EXIT_CODES, causes, interruption
from render.errors import TactiluxError

NO_MEMORY = re.compile(
    "allocate|bad_alloc|out of memory|start new thread|failed to map segment", re.IGNORECASE
)
"""What libraries say of memory that they do not get."""
NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
PACKAGES = {
    "explore": ("cma", "glcontext", "jinja2", "matplotlib", "moderngl", "numba", "scipy",
                "tomlkit", "trimesh"),
    "train": ("cryptography", "dask", "distributed", "drjit", "mitsuba", "onnx", "sklearn",
              "torch"),
    "hw": ("cv2", "serial", "yaml"),
}  # fmt: skip
"""What the extras of pyproject.toml install, by the names that are imported."""

app = typer.Typer(
    name="tactilux",
    help="Choose and verify the lights of a vision-based tactile sensor.",
    no_args_is_help=True,
    epilog=EXIT_CODES,
    # Plain help and plain tracebacks: rich would double the time that --help takes.
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
for _command in (
    explore, play, score, compare, verify, optimize, sensitivity, reconstruct, train, frontier,
    overnight, status, report, runs, render, describe, colors, new, schema,
):  # fmt: skip
    app.command(_command.__name__.rpartition(".")[2], cls=Command)(_command.run)


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
    """Run the program; what a user can mend is one sentence on stderr, see `EXIT_CODES`."""
    try:
        app()
    except SystemExit as end:
        broken = end.__context__
        if isinstance(broken, BrokenPipeError):  # of a board or a scheduler; Typer says nothing
            _refuse(_sentence(broken))
        if end.code == 130 and not isinstance(broken, KeyboardInterrupt):
            _interrupted(end)
        raise
    except BaseException as error:
        if interruption(error) is not None:
            _interrupted(error)
        sentence = _sentence(error)
        if sentence is None:
            raise
        _refuse(sentence)


def _interrupted(error: BaseException) -> NoReturn:
    print("tactilux: interrupted", file=sys.stderr)
    sys.exit(interruption(error) or 130)


def _refuse(sentence: str | None) -> NoReturn:
    print(f"tactilux: {sentence}", file=sys.stderr)
    sys.exit(2)


def _sentence(error: BaseException) -> str | None:
    """Return what a user reads instead of a traceback; None for a mistake of the program."""
    if isinstance(error, TactiluxError):
        return f"{error} ({error.option})" if error.option else str(error)
    if isinstance(error, ModuleNotFoundError):
        package = (error.name or "").partition(".")[0]
        extra = next((name for name, packages in PACKAGES.items() if package in packages), None)
        if extra is None:
            return None
        return (
            f"this command needs {package}, which is not installed: in the folder of tactilux's "
            f'sources run: pip install ".[{extra}]"'
        )
    if isinstance(error, OSError):
        step = "choose another place, or mend that and give the same command again"
        if error.errno in NO_ROOM:
            step = "make room and give the same command again"
        place = "" if error.filename is None else f"{os.fsdecode(error.filename)}: "
        return f"{place}{error.strerror or error}; {step}"
    if isinstance(error, MemoryError) or any(NO_MEMORY.search(str(e)) for e in causes(error)):
        return "there is not enough memory: close other programs, or ask for less"
    return None
