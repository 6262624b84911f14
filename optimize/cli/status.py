"""``tactilux status``: how far a run is, also while it works."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from typer import Argument, BadParameter, Option

from optimize.cli.options import Json
from optimize.ui.console import counted, duration, print_json, print_table, reserved_stdout

_WORDS = {
    "running": "works now",
    "finished": "is finished",
    "stopped": "was stopped; the same command goes on",
    "lost": "was killed; the same command goes on",
    "failed": "ended by an error, which its log tells; the same command goes on",
}


def run(
    directory: Annotated[Path, Argument(metavar="run", help="Directory of an overnight run.")],
    scaling: Annotated[
        bool, Option("--scaling", help="Say what 2, 8 and 64 workers would do.")
    ] = False,
    serve: Annotated[
        bool, Option("--serve", help="Follow it on a page in a browser, until Ctrl-C.")
    ] = False,
    port: Annotated[
        int | None,
        Option(min=0, max=65535, help="Of --serve, on this machine alone (default: 8736)."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Say how far an overnight run is, also while it works."""
    if serve and (as_json or scaling):
        raise BadParameter("--serve answers in a browser: leave --json and --scaling out")
    if port is not None and not serve:
        raise BadParameter("--port is for --serve: give both, or none")
    if serve:
        _serve(directory, port)
        return
    from optimize.overnight.status import SCALING_WORDS, scaling_of, scaling_rows, status_of

    with reserved_stdout() as stream:
        found = status_of(directory)
        more = scaling_of(directory) if scaling else None
        if as_json:
            extra = {} if more is None else {"scaling": more}
            print_json(stream, asdict(found) | extra)
            return
        by = f" ({found.holder})" if found.holder else ""
        stream.write(f"{directory} {_WORDS[found.state]}{by}\n")
        if found.stage and found.state != "finished":
            stream.write(f"Stage: {found.stage}, {100 * found.share:.0f} %\n")
        if found.best is not None:
            stream.write(f"Best so far: {found.best_words}\n")
        stream.write(
            f"Renders: {found.evaluations} in {duration(found.render_seconds)} of rendering\n"
            f"Worked: {duration(found.seconds)} in {counted(found.attempts, 'attempt')}\n"
        )
        if found.eta_seconds is not None:
            stream.write(f"Left: {duration(found.eta_seconds)}\n")
        if more is not None:
            headings = ("workers", "the night takes", "times as fast")
            rows = scaling_rows(more)
            print_table(stream, "More workers", headings, rows, words=(), below=SCALING_WORDS)


def _serve(directory: Path, port: int | None) -> None:
    from optimize.overnight.follow import PORT, StatusServer

    with (
        reserved_stdout() as stream,
        StatusServer(directory, PORT if port is None else port) as server,
    ):
        stream.write(f"{server.url} follows {directory} until Ctrl-C\n")
        stream.flush()
        server.serve_forever()
