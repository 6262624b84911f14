"""A study on paper: its table, its plot, a page, and the best sensor as a scene file."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from optimize.design import SCENE, keep_scene, save_design
from optimize.dimensions.answer import EFFORT_NAMES
from optimize.dimensions.dimension import Dimension
from optimize.dimensions.kept_answers import ANSWERS
from optimize.dimensions.study import Study, StudyRow
from optimize.objectives import READERS, ReaderName, title_of
from optimize.readers import CameraModel
from optimize.report import (
    DESIGN,
    building_steps,
    data_uri,
    drawing,
    png_bytes,
    render_page,
    sensor_figure,
    verification_steps,
)
from optimize.ui.console import counted, print_table
from optimize.ui.output import MANIFEST, writable
from optimize.ui.provenance import package_versions
from render.files import write_bytes, write_json, write_text
from render.scene import rewritten, save_scene, standalone

PAGE, PLOT, BEST, PLAN = "dimensions.html", "dimensions.png", "best.toml", "study.json"
PRESENT_DESIGN, POINTS = "as-it-is.json", "points"
"""Files of a study; `PLAN` is there from its beginning. In `POINTS` is a folder for each row."""
MARK = "●"
"""Of rows that no other beats."""
SAMPLES, MOST_ROWS = 400, 20
"""Of renders that the page asks for, and rows that a terminal shows."""
COLORS: dict[ReaderName, str] = {"sensor": "#1d4ed8", "place": "#b45309"}
LEGEND = (
    "Readers: degrees by which they miss surface normals with the baseline's lights, then with the "
    "best found for that sensor; sensor: one smooth map for the whole sensor; place: a lookup that "
    "knows every place. Light: that reaches the camera, relative to the sensor as it is. Change: "
    "from the sensor as it is, each with its best lights; 95 % intervals of all rows at once, with "
    "what the model errs by. The photon noise of traced light is taken out of all errors."
)
PARETO = (
    f" {MARK}: no other row has less error at no more of any limit. With more of a limit the best "
    "design of all that it allows is kept, so that errors do not rise."
)


def rows_of(study: Study, most: int | None = None) -> list[StudyRow]:
    """Return the rows in the order of a table, finalists last, the others at ``most`` so many.

    One dimension is in the order of its values, several are from the best on. What is left out is
    what is worst, never the sensor as it is.
    """
    rows = list(study.rows)
    ranked = sorted(rows, key=lambda row: row.answer.best.mean(study.reader))
    if len(study.variants.dimensions) > 1:
        rows = ranked
    kept = {row for row in rows if not row.changes} | set(ranked[:most])
    return [row for row in rows if row in kept] + list(study.finalists)


def table_of(study: Study, most: int | None = None) -> tuple[list[str], list[list[str]]]:
    """Return headings and cells of the rows of `rows_of`."""
    names = [one.key + (f", {one.unit}" if one.unit else "") for one in study.variants.dimensions]
    marked = ["Pareto"] if study.pareto else []
    headings = [
        *names, "sensor reader", "place reader", "light", f"change, {study.reader}", "effort",
        *marked,
    ]  # fmt: skip
    return headings, [_cells(study, row) for row in rows_of(study, most)]


def legend_of(study: Study) -> str:
    """Return what the columns of the table mean."""
    return LEGEND + (PARETO if study.pareto else "")


def _cells(study: Study, row: StudyRow) -> list[str]:
    said = row.answer
    errors = [
        f"{said.baseline.mean(reader):.2f} → {said.best.mean(reader):.2f}°" for reader in READERS
    ]
    change = row.changes[study.reader].words if row.changes else "as it is"
    base = next(one for one in study.rows + study.finalists
                if not one.changes and one.answer.effort == said.effort)  # fmt: skip
    light = base.answer.best.exposure / said.best.exposure
    mark = MARK if row in study.rows and row.values in study.pareto else ""
    return [
        *(f"{value:g}" for value in row.values),
        *errors, f"{light:.2f}", change, EFFORT_NAMES[said.effort],
        *([mark] if study.pareto else []),
    ]  # fmt: skip


def print_study_table(stream: IO[str], study: Study) -> None:
    """Print the table and what came out."""
    headings, rows = table_of(study, MOST_ROWS)
    title = f"{study.scene.name}, {study.scene.hash}"
    words = headings[headings.index("light") + 1 :]
    print_table(stream, title, headings, rows, words=words, below=legend_of(study))
    left_out = len(study.rows) + len(study.finalists) - len(rows)
    if left_out:
        stream.write(f"{counted(left_out, 'sensor')} that read worse: on the page.\n")
    stream.write("".join(f"{text}\n" for text in (study.sentence, study.worse) if text))
    for text in study.warnings():
        stream.write(f"Note: {text}\n")


def study_figure(study: Study) -> Figure:
    """Return the errors over the values of each dimension, a panel each.

    Lines where there is one dimension, dots where there are several; bars are the intervals of the
    change, around the error with the best lights.
    """
    dimensions = study.variants.dimensions
    with drawing(3.4 + 2.8 * len(dimensions), 3.6) as figure:
        panels = figure.subplots(1, len(dimensions), sharey=True, squeeze=False)[0]
        for number, (axes, one) in enumerate(zip(panels, dimensions, strict=True)):
            _draw(axes, study, one, number)
        panels[0].set_ylabel("error of normals, degrees")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside right center", frameon=False)
        return figure


def _draw(axes: Axes, study: Study, one: Dimension, number: int) -> None:
    alone = len(study.variants.dimensions) == 1
    x = [row.values[number] for row in study.rows]
    for reader, color in COLORS.items():
        best = [row.answer.best.mean(reader) for row in study.rows]
        base = [row.answer.baseline.mean(reader) for row in study.rows]
        title = title_of(reader)
        if alone:
            axes.plot(x, base, "--", color=color, lw=1.0, label=f"{title}, baseline lights")
        style = "-o" if alone else "o"
        axes.plot(x, best, style, color=color, lw=1.4, ms=4, label=f"{title}, best lights")
        if reader == study.reader:
            _draw_intervals(axes, study.rows, number, reader, color)
            _draw_pareto(axes, study, number, color)
        if study.finalists:
            at = [row.values[number] for row in study.finalists]
            fine = [row.answer.best.mean(reader) for row in study.finalists]
            axes.plot(at, fine, "D", color=color, ms=6, mfc="white", mew=1.4,
                      label=f"{title}, converged light")  # fmt: skip
            if reader == study.reader:
                _draw_intervals(axes, study.finalists, number, reader, color)
    axes.axvline(one.present, color="#8a8f98", lw=0.9, ls=":", label="as it is")
    if one.is_limit:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_xlabel(one.key + (f", {one.unit}" if one.unit else ""))
    axes.grid(which="major", lw=0.4, color="#d7dade")
    axes.set_ylim(bottom=0.0)


def _draw_pareto(axes: Axes, study: Study, number: int, color: str) -> None:
    """Ring the rows that no other beats."""
    best = [row for row in study.rows if row.values in study.pareto]
    if best:
        at = [row.values[number] for row in best]
        errors = [row.answer.best.mean(study.reader) for row in best]
        axes.plot(at, errors, "o", color=color, ms=10, mfc="none", mew=1.2,
                  label=f"{title_of(study.reader)}, Pareto")  # fmt: skip


def _draw_intervals(
    axes: Axes, rows: tuple[StudyRow, ...], number: int, reader: ReaderName, color: str
) -> None:
    base = next(row.answer.best.mean(reader) for row in rows if not row.changes)
    for row in rows:
        if row.changes:
            low, high = (base * (1.0 + end) for end in row.changes[reader].interval)
            axes.plot([row.values[number]] * 2, [low, high], color=color, lw=0.8, alpha=0.6)


def begin_study(target: Path, study_plan: dict[str, Any]) -> Path:
    """Write what is asked into the folder of a study, and return where its answers are kept."""
    with writable(target):
        (target / MANIFEST).unlink(missing_ok=True)
        write_json(target / PLAN, study_plan, indent=2)
    return target / ANSWERS


def write_study(target: Path, study: Study) -> dict[str, Any]:
    """Write table, plot, page, the best sensor and its lights, and return the result.

    The result is written last.
    """
    best, scene = study.best, study.best.scene
    present = study.variants.at(study.variants.present)
    kept = standalone(present)
    with writable(target):
        keep_scene(target, kept)
        save_scene(target / BEST, scene)
        save_design(target / DESIGN, best.design, scene, best.rating)
        base = study.rated(study.present, "present", "As it is", present)
        save_design(target / PRESENT_DESIGN, base.design, present, base.rating)
        points = _write_points(target, study)
        plot = png_bytes(study_figure(study), dpi=150)
        write_bytes(target / PLOT, plot)
        write_text(target / PAGE, _page(target, study, plot))
        result = study.to_json() | {
            "best_scene": str(target / BEST),
            "design": str(target / DESIGN),
            "report": str(target / PAGE),
            "plot": str(target / PLOT),
        }
        for row, point in zip(result["rows"], points, strict=False):
            row["design"] = str(point)
        write_json(target / MANIFEST, result, indent=2)
    return result


def _write_points(target: Path, study: Study) -> list[Path]:
    """Write scene and design of each row of a map of costs, and return the designs in order."""
    written = []
    for row in study.rows if study.pareto else ():
        folder = target / POINTS / "-".join(f"{value:g}" for value in row.values)
        scene = study.scene_of(row)
        if row.changes:
            shown = study.variants.shown(row.values)
            scene = rewritten(scene, f"{shown} of tactilux explore {study.flags}")
            save_scene(folder / SCENE, scene)
        else:
            keep_scene(folder, standalone(scene))
        point = study.rated(row, "point", study.variants.shown(row.values), scene)
        save_design(folder / DESIGN, point.design, scene, point.rating)
        written.append(folder / DESIGN)
    return written


def _page(target: Path, study: Study, plot: bytes) -> str:
    headings, rows = table_of(study)
    chosen = rows_of(study)
    context = {
        "scene": study.scene.name,
        "scene_hash": study.scene.hash,
        "bends": study.scene.state_titles,
        "sentence": " ".join((study.sentence, study.worse)).strip(),
        "warnings": study.warnings(),
        "headings": headings,
        "rows": [
            {"cells": cells, "best": row is study.chosen}
            for cells, row in zip(rows, chosen, strict=True)
        ],
        "legend": legend_of(study),
        "plot": data_uri(plot),
        "plot_text": ", ".join(one.key for one in study.variants.dimensions),
        "sensor": sensor_figure(study.best.scene),
        "camera": CameraModel.of(study.scene).sentence,
        "steps": list(_steps(target, study)),
        "facts": list(_facts(study)),
    }
    return render_page("dimensions.html.j2", context)


def _steps(target: Path, study: Study) -> Iterator[tuple[str, str]]:
    best, design = target / BEST, target / DESIGN
    yield (
        "Search the lights of this sensor with everything that belongs to it:",
        f"tactilux explore {shlex.quote(str(best))}",
    )
    yield from verification_steps(design, str(best), study.best.rating.effort)
    if study.chosen.changes:
        yield (
            "Let renders decide whether it is better than the sensor as it is:",
            f"tactilux compare {shlex.quote(str(target / PRESENT_DESIGN))} "
            f"{shlex.quote(str(design))} --samples {SAMPLES}",
        )
    if study.variants.place:
        yield (
            "Write the sensor that it is, with the lamps that are lit:",
            f"tactilux build {shlex.quote(str(design))} --out mine.toml",
        )
    yield from building_steps(design, str(best))


def _facts(study: Study) -> Iterator[tuple[str, str]]:
    yield "Dimensions", study.flags
    yield "Sensors", f"{len(study.rows)} answered of {len(study.variants)}"
    yield "Searched", f"lights for the {title_of(study.reader)}, seed {study.seed}"
    if study.pareto:
        yield "Points", f"{POINTS}/VALUE/{DESIGN} and {SCENE} of every row"
    yield "Kept", f"{SCENE} as it was, {BEST} and {DESIGN} of the best, {PRESENT_DESIGN}"
    yield "Made", datetime.now(UTC).strftime("%d %B %Y, %H:%M UTC")
    yield "Versions", ", ".join(f"{k} {v}" for k, v in package_versions("numpy").items())
