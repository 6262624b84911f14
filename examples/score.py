"""What a score is worth: pictures and figures of docs/score.md, made again.

``python examples/score.py docs`` rates a poor, a usable and a good design of finger20 on its
surrogate, draws what the camera sees of each, measures what a count is worth in degrees, and
writes ``score-*.png`` and the tables of ``score.md`` between their marks.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.stats import kendalltau

import tactilux
from optimize.design import limits_of
from optimize.exploration import Stage, rate
from optimize.report import picture_png
from render.metric import THESIS

WIDTH = 180  # pixels of a picture
TRIALS = 40
ENOUGH = 200.0
"""Counts above which a count is worth the same, nearly."""


def anchors(scene: tactilux.Scene, model: tactilux.Checker) -> dict[str, Stage]:
    """Return the designs of the page, rated, by the name of their picture."""
    usable = tactilux.baseline_design(scene)
    straight, fibers = usable.phi, np.arange(scene.lamp_count)
    designs = {
        "poor": tactilux.Design.of_colors(straight, fibers % 3),
        "usable": usable,
        "good": tactilux.explore(scene, model=model, objective="score").design,
        "fooled": tactilux.Design.of_colors(straight, 0 * fibers),
    }
    return {name: rate(model, scene, name, name, "", each) for name, each in designs.items()}


def worth(scene: tactilux.Scene, model: tactilux.Checker, good: Stage) -> tuple[float, float, int]:
    """Return degrees per count, Kendall's tau of S and degrees, and how many designs said so.

    Designs lie around a good one: some fibers take a random color and every one is turned, as
    long as the design is above `ENOUGH` counts.
    """
    rng, limits, pairs = np.random.default_rng(0), limits_of(scene), []
    for _ in range(TRIALS):
        colors = good.design.colors.copy()
        changed = rng.choice(len(colors), rng.integers(0, 8), replace=False)
        colors[changed] = rng.integers(0, 3, len(changed))
        phi = np.clip(good.design.phi + rng.normal(0.0, 0.3, len(colors)), 0.0, np.pi)
        trial = tactilux.Design.of_colors(limits.nearest_directions(phi), colors)
        rated = rate(model, scene, "trial", "", "", trial)
        if rated.rating.score > ENOUGH:
            pairs.append((rated.rating.score, rated.reader_error))
    score, degrees = np.array(pairs).T
    slope = float(np.polyfit(score, degrees, 1)[0])
    return -slope, -float(kendalltau(score, degrees).statistic), len(pairs)


def tables(rated: Mapping[str, Stage], value: tuple[float, float, int]) -> dict[str, str]:
    """Return the figures of the page as Markdown, by their marks."""
    words = {
        "poor": "poor: red, green and blue in turn, so every place is lit by all colors",
        "usable": "usable: the baseline, one color per side",
        "good": "good: what `tactilux explore --objective score` finds",
        "fooled": "looks usable by S: all fibers red",
    }
    rows = [
        "| design | what the camera sees, flat | S | mean M | spreads "
        "| sensor reader | place reader |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, stage in rated.items():
        parts = stage.rating
        rows.append(
            f"| {words[name]} | ![{name}](score-{name}.png) | {parts.score:.0f} | "
            f"{parts.mean:.0f} | {parts.spread_sites:.0f}, {parts.spread_bends:.0f} | "
            f"{stage.reader_error:.2f}° | {stage.normal_error:.2f}° |"
        )
    usable, good = rated["usable"], rated["good"]
    gain = good.rating.score - usable.rating.score
    saved = usable.reader_error - good.reader_error
    slope, tau, count = value
    return {
        "anchors": "\n".join(rows),
        "worth": (
            f"From the usable to the good design, {gain:.0f} counts are worth {saved:.2f}° of "
            f"the sensor reader: {100 * saved / gain:.1f} hundredths of a degree each. Of {count} "
            f"random designs around the good one, all above {ENOUGH:.0f} counts, the line of best "
            f"fit has {100 * slope:.1f} hundredths of a degree per count, and S orders pairs of "
            f"them as the degrees do with Kendall's tau {tau:.2f}."
        ),
    }


def written(page: str, parts: Mapping[str, str]) -> str:
    """Return the page with every part between its marks."""
    for mark, text in parts.items():
        marks = re.compile(rf"(<!-- {mark} -->\n).*?(\n<!-- /{mark} -->)", re.DOTALL)
        page = marks.sub(lambda found, text=text: found[1] + text + found[2], page)
    return page


def main(arguments: list[str]) -> None:
    """Write pictures and tables into a folder that holds ``score.md``."""
    folder = Path(*arguments)
    scene = tactilux.load_scene("finger20")
    model = tactilux.load_model(scene)
    rated = anchors(scene, model)
    height = round(WIDTH * scene.camera.rows / scene.camera.columns)
    with tactilux.Preview(scene) as preview:
        for name, stage in rated.items():
            seen = preview.picture(stage.design.phi, stage.design.power, 0.0, WIDTH, height)
            counts = seen.astype(float) * stage.settings.exposure
            (folder / f"score-{name}.png").write_bytes(picture_png(counts / THESIS.count_max))
    parts = tables(rated, worth(scene, model, rated["good"]))
    page = folder / "score.md"
    page.write_text(written(page.read_text(encoding="utf-8"), parts), encoding="utf-8")
    print("\n\n".join(parts.values()))


if __name__ == "__main__":
    main(sys.argv[1:])
