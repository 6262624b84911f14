"""Figures of the thesis, made again: ``python examples/figures.py FIGURE OUT``.

FIGURE is 3.2, 3.3, 3.5, 3.6, 5.1, 5.2 or 5.3. Written are ``fig-FIGURE.png`` and, with the numbers
in it, ``fig-FIGURE.json``. docs/figures.md says what agrees with the thesis and what does not.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import tactilux

sys.path.insert(0, str(Path(__file__).parent))

FIGURES = ("3.2", "3.3", "3.5", "3.6", "5.1", "5.2", "5.3")
Say = Callable[[str], None]


def make(figure: str, path: Path, effort: argparse.Namespace, say: Say) -> Any:
    """Draw one figure into ``path`` and return its numbers."""
    if figure in ("3.2", "3.3"):
        return _renderers(figure, path, effort, say)
    if figure in ("3.5", "3.6"):
        from thesis import rig

        draw = rig.reference_lines if figure == "3.5" else rig.all_fibers
        return draw(effort.rig_samples, path, say)
    from thesis import designs

    entries = designs.rated(effort.samples if figure == "5.1" else 0, say)
    drawn = {"5.1": designs.heat_maps, "5.2": designs.patches, "5.3": designs.bolts}
    return drawn[figure](entries, path)


def _renderers(figure: str, path: Path, effort: argparse.Namespace, say: Say) -> Any:
    from thesis import renderers

    from render.reference import VARIANT, mitsuba

    mitsuba(VARIANT)
    lit = renderers.sensor()
    if figure == "3.3":
        rows = renderers.luminance_scale(lit, effort.most, say)
        renderers.draw_scale(rows, path)
        return rows
    shots, truth = renderers.pictures(lit, effort.spp, effort.seconds, say)
    renderers.draw_pictures(shots, truth, path)
    return [
        {
            "at": title,
            "integrator": shot.integrator,
            "spp": shot.spp,
            "seconds": shot.seconds,
            "error": shot.error(truth),
        }
        for title, pictures in shots.items()
        for shot in pictures
    ]


def main(arguments: list[str]) -> None:
    """Write one figure and its numbers."""
    parser = argparse.ArgumentParser(prog="python examples/figures.py", description=__doc__)
    parser.add_argument("figure", choices=FIGURES)
    parser.add_argument("out", type=Path, help="folder for the results")
    parser.add_argument("--spp", type=int, default=64, help="3.2: samples per pixel")
    parser.add_argument("--seconds", type=float, default=100.0, help="3.2: equal processor time")
    parser.add_argument("--most", type=int, default=10_000_000, help="3.3: luminance samples")
    parser.add_argument(
        "--rig-samples", type=int, default=200, help="3.5, 3.6: light paths per fiber and cell"
    )
    parser.add_argument(
        "--samples", type=int, default=0, help="5.1: render with so many per cell (0: surrogate)"
    )
    chosen = parser.parse_args(arguments)
    began = time.monotonic()

    def say(line: str) -> None:
        print(f"{time.monotonic() - began:7.1f} s  {line}", file=sys.stderr, flush=True)

    chosen.out.mkdir(parents=True, exist_ok=True)
    path = chosen.out / f"fig-{chosen.figure}.png"
    try:
        numbers = make(chosen.figure, path, chosen, say)
    except tactilux.TactiluxError as error:
        print(f"figures.py: {error}", file=sys.stderr)
        sys.exit(2)
    path.with_suffix(".json").write_text(json.dumps(numbers, indent=1) + "\n")
    print(path)


if __name__ == "__main__":
    main(sys.argv[1:])
