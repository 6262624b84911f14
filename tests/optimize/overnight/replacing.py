"""Replaces a result in which somebody has put work of his own: a program for a test to record.

Usage: replacing.py FOLDER
"""

from __future__ import annotations

import sys
from pathlib import Path

from optimize.ui.output import fresh_directory, write_manifest
from render.files import write_bytes

RESULT, PAGE, RENDERS = "result", "report.html", "design-renders"
PAGES = tuple(text.encode() * 300 for text in ("first ", "second "))
RENDER = b"hours of work " * 300


def replace(folder: Path, page: bytes) -> None:
    """Write a result of one page, in the place of an earlier one."""
    with fresh_directory(folder / RESULT) as work:
        write_bytes(work / PAGE, page)
        write_manifest(work, {})


def main() -> None:
    """Write a result, put a render into its folder, and write another result."""
    folder = Path(sys.argv[1])
    replace(folder, PAGES[0])
    write_bytes(folder / RESULT / RENDERS / "pad.npz", RENDER)
    print("rendered", flush=True)
    replace(folder, PAGES[1])


if __name__ == "__main__":
    main()
