"""Renders held against what others measured: ``python examples/outside_truth.py FOLDER``.

FOLDER holds repositories of others, as ``git clone`` leaves them. What is not there is left out,
and a line says how to get it. docs/outside-truth.md has the results and what does not agree.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from truth import cmu, gssim
from truth.comparison import (
    Array,
    Light,
    Row,
    by_color,
    linear,
    previewed,
    rendered,
    touched,
)

import tactilux

SOURCES = {
    "tactile_optical_simulation": ("CMURoboTouch", "no licence stated: compare, pass nothing on"),
    "gssim": ("gelsightinc", "Apache-2.0"),
    "tacto": ("facebookresearch", "MIT"),
}
"""Folder, its owner on GitHub, its licence."""

# ------------------------------------------- DIGIT -----------------------------------------------


def layout(picture: Array) -> dict[str, float]:
    """Return what is said of a picture ``(row, column, red green blue)``, linear.

    How far the middle of red lies left of that of green, in widths of the picture, and how far
    red falls from its brightest column to the darkest one right of it: of the means over all rows,
    and of the eighth of the rows around the brightest.
    """
    rows, columns = picture.shape[:2]
    at = (np.arange(columns) + 0.5) / columns
    middle = [at @ channel / channel.sum() for channel in picture.mean(axis=0).T]
    red = picture[..., 0]
    best, reach = int(red.mean(axis=1).argmax()), max(rows // 16, 1)
    band = red[max(best - reach, 0) : best + reach]

    def fall(profile: Array) -> float:
        return float(profile.max() / profile[profile.argmax() :].min())

    return {
        "red left of green": float(middle[1] - middle[0]),
        "red falls, all rows": fall(red.mean(axis=0)),
        "red falls, its rows": fall(band.mean(axis=0)),
    }


DIGITS = {"digit": 14, "digit-dome": 12}
"""Scenes of a DIGIT, and how many rows of places, 1.6 mm apart, their cameras see whole."""


def drawn_digit(light: Light, name: str) -> Array:
    """Return the untouched skin of a DIGIT's scene, ``(row, column, color)``, as its camera does.

    Rows count from the top, and columns run towards -x.
    """
    scene, rows = tactilux.load_scene(name), DIGITS[name]
    scene = touched(scene, {"columns": 10, "rows": rows, "spacing": 1.6}, faces=3, radius=0.5)
    return by_color(scene, light(scene)[1]).reshape(rows, 10, 3)[::-1, ::-1]


def digit(folder: Path, light: Light) -> Iterator[Row]:
    """Compare the colors of the untouched pad: red left of green, and fading to the right."""
    real = layout(linear(folder / "examples" / "conf" / "bg_digit_240_320.jpg", True))
    for name in DIGITS:
        drawn = drawn_digit(light, name)
        found, mirrored = layout(drawn), layout(drawn[:, ::-1])
        for what, goal in zip(found, (">= 0", ">= 5", ">= 5"), strict=True):
            beside = {"photograph": real[what], "mirrored": mirrored[what]}
            yield Row(f"{name}: {what}", found[what], goal, beside)


# ------------------------------------------ Command ----------------------------------------------

COMPARISONS: dict[str, Callable[[Path, Light], Iterator[Row]]] = {
    "tactile_optical_simulation": cmu.rows,
    "gssim": gssim.rows,
    "tacto": digit,
}


def main(arguments: list[str]) -> int:
    """Print one table; 0 where every goal is met that could be asked, 2 where none could be."""
    parser = argparse.ArgumentParser(prog="python examples/outside_truth.py", description=__doc__)
    parser.add_argument("folder", type=Path, help="holds the repositories")
    parser.add_argument("--samples", type=int, default=0, help="per cell, 0: the preview")
    parser.add_argument("--seed", type=int, default=1, help="of the reference")
    chosen = parser.parse_args(arguments)
    light = partial(rendered, samples=chosen.samples, seed=chosen.seed)
    began, missed, compared = time.monotonic(), 0, 0
    print(f"{'':<42}{'goal':>8}{'found':>9}      wrong on purpose, or beside it")
    for name, (owner, licence) in SOURCES.items():
        if not (chosen.folder / name).is_dir():
            command = f"git clone https://github.com/{owner}/{name} {chosen.folder / name}"
            print(f"{name} is not there ({licence}): {command}")
            continue
        for row in COMPARISONS[name](chosen.folder / name, light if chosen.samples else previewed):
            print(row, flush=True)
            missed += not row.met
            compared += 1
    if not compared:
        print(f"Nothing could be compared: {chosen.folder} holds none of {', '.join(SOURCES)}")
        return 2
    level = f"reference, {chosen.samples} samples per cell, seed {chosen.seed}"
    print(f"{level if chosen.samples else 'preview'}, {time.monotonic() - began:.0f} s")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
