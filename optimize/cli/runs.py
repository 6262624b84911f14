"""``tactilux runs``: what is in a folder of runs, as a table and as a page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from optimize.cli.options import Json
from optimize.ui.console import note, print_json, print_table, reserved_stdout
from optimize.ui.terminal_text import one_line


def run(
    folder: Annotated[Path, Argument(help="Where the runs are, in it or below.")] = Path(),
    out: Annotated[
        Path | None, Option(help="Write a page with pictures and links to this .html file.")
    ] = None,
    as_json: Json = False,
) -> None:
    """List the runs of a folder, damaged and unfinished ones too."""
    from optimize.records import (
        degrees_text,
        find_runs,
        record_to_json,
        score_text,
        when_text,
        write_runs_page,
    )
    from optimize.ui.output import check_file

    with reserved_stdout() as stream:
        if out is not None:
            check_file(out, (".html", ".htm"))
        found = find_runs(folder, _say_unread)
        if out is not None:
            write_runs_page(out, folder, found)
        if as_json:
            page = None if out is None else str(out)
            told = [record_to_json(record) for record in found]
            print_json(stream, {"folder": str(folder), "runs": told, "page": page})
            return
        if not found:
            stream.write(f"There is no run in {folder} yet: tactilux explore makes one\n")
        else:
            rows = [
                (
                    str(record.path),
                    record.kind if record.state == "finished" else f"{record.kind}, {record.state}",
                    record.scene,
                    record.level_name,
                    *degrees_text(record),
                    *score_text(record),
                    when_text(record),
                )
                for record in found
            ]
            headings = ("run", "kind", "scene", "level", "sensor", "place", "score S", "interval",
                        "written")  # fmt: skip
            print_table(stream, "", headings, rows, words=headings[:4])
        for record in found:
            if record.state != "finished":
                stream.write(one_line(f"{record.path}, {record.state}: {record.note}") + "\n")
        if out is not None:
            stream.write(f"Page: {out}, open it in a browser\n")


def _say_unread(error: OSError) -> None:
    note(f"{error.filename} cannot be read ({error.strerror}): runs in it are not listed")
