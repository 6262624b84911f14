"""``tactilux report``: the report of a finished night, rebuilt from its files alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument

from optimize.ui.console import reserved_stdout


def run(
    directory: Annotated[Path, Argument(metavar="run", help="The directory of a finished night.")],
) -> None:
    """Write the report of a finished night again, from its files."""
    from optimize.overnight.report import write_report
    from optimize.overnight.result import OvernightResult
    from optimize.ui.output import OutputError

    with reserved_stdout() as stream:
        result = OvernightResult.load(directory)
        try:
            path = write_report(result, directory)
        except OSError as error:
            raise OutputError(
                f"{directory} cannot be written ({error.strerror}): copy the run directory to a "
                "place where it can and report from there",
                field="run",
            ) from None
        stream.write(f"Report: {path}\n")
