"""``tactilux parts``: the LEDs that lamps may be, in the numbers of their data sheets."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

from optimize.cli.options import Json
from optimize.ui.console import print_json, print_table, reserved_stdout


def run(
    out: Annotated[Path | None, Option(help="Write the list as a page to this .md file.")] = None,
    as_json: Json = False,
) -> None:
    """List the LEDs that lamps may be, for --parts."""
    from optimize.ui.output import check_file, write_result
    from render.scene import shipped_leds
    from render.scene.catalog.listing import HEADINGS, content_of, page_of, rows_of

    with reserved_stdout() as stream:
        if out is not None:
            check_file(out, (".md",))
            write_result(out, page_of(shipped_leds()).encode())
        if as_json:
            page = None if out is None else str(out)
            print_json(stream, {"parts": content_of(shipped_leds()), "page": page})
        else:
            below = (
                "half angle: at which the beam has half its intensity; mW: radiant power at that "
                "current. Data sheets and how to add a part: docs/parts.md and docs/scenes.md."
            )
            rows = rows_of(shipped_leds())
            print_table(stream, "", HEADINGS, rows, words=HEADINGS[:2], width=112, below=below)
