"""The report of a night: one HTML file that needs nothing else, for screen, phone and paper.

It is made from the files of the finished night alone, and equal files make equal reports.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from optimize.design import RUN_MODEL, SCENE
from optimize.frontier.plot import draw_levels
from optimize.mounting import ErrorCost, mount, mounting_error_costs, surrogate_score
from optimize.objectives import ERROR_KEYS, sign_of, title_of
from optimize.overnight.result import (
    DESIGNS,
    ConvergencePoint,
    Finalist,
    OvernightResult,
    RenderedFigure,
)
from optimize.overnight.run_directory import RECORD, REPORT
from optimize.overnight.status import SCALING_WORDS, scaling_of, scaling_rows
from optimize.readers import CameraModel
from optimize.report import (
    bolt_pictures,
    building_steps,
    clipping_warning,
    data_uri,
    design_pictures,
    drawing,
    holder_warning,
    monochrome_warning,
    png_bytes,
    render_page,
    score_row,
    sensor_figure,
    stage_pictures,
    wiring_context,
)
from render.errors import ModelError, SceneError
from render.files import write_text
from render.geometry import BoltHead
from surrogate.runtime import Checker

HOLDS = {"holds": "yes", "does not hold": "no", "cannot be tested": "cannot tell"}


def write_report(result: OvernightResult, run: Path) -> Path:
    """Write ``report.html`` into ``run`` atomically and return its path."""
    path = run / REPORT
    scaling = scaling_of(run) if (run / RECORD).is_file() else None
    checker = None
    with suppress(ModelError):  # a copy of the run without its model
        checker = Checker.load(run / RUN_MODEL, result.scene.hash)
    write_text(path, render_report(result, scaling, checker))
    return path


def warnings(result: OvernightResult) -> list[str]:
    """Return what makes the result doubtful, most important first; usually nothing."""
    last, doubts = result.best, []
    sign = sign_of(result.objective)
    figure = last.figure(result.objective)
    if figure.gain is not None and figure.gain_se is not None:
        gain, half = sign * figure.gain, result.interval_factor * figure.gain_se
        if not (last.converged and result.finalists[0].converged):
            doubts.append(
                "Few light paths carry most of the light, so these renders decide nothing: the "
                "same command with more hours goes on from here."
            )
        elif gain + half < 0:
            doubts.append("The renders say that the baseline is better: this design is not one.")
        elif gain - half <= 0:
            doubts.append(
                "The interval of the gain reaches 0: more hours would make it narrower, and the "
                "same command with more of them goes on from here."
            )
        doubts += holder_warning(result.scene, last.design)
        doubts += monochrome_warning(last.design)
    for entry in result.finalists:
        ahead = sign * (entry.figure(result.objective).value - figure.value)
        if ahead > 0 and entry.converged and last.converged:
            said = f"scored {ahead:.1f} higher" if sign > 0 else f"was read {ahead:.2f}° better"
            doubts.append(
                f"{entry.title} {said} in the last renders, which is within the error bars of the "
                "difference: they tie, and the choice of the rounds before stands."
            )
    return doubts + clipping_warning(last.clipped)


def render_report(
    result: OvernightResult,
    scaling: dict[int, float] | None = None,
    checker: Checker | None = None,
) -> str:
    """Return the report as HTML with every picture inside as a data URI.

    ``checker`` is the night's model, which prices the rounding of angles and errors in building.
    """
    scene, last = result.scene, result.best
    mounting, errors = mount(scene, last.design), list[ErrorCost]()
    if checker is not None:
        mounting = mount(scene, last.design, surrogate_score(checker, scene))
        errors = mounting_error_costs(checker, scene, mounting.design)
    pictures = dict(report_pictures(result))
    rows = {entry.key: _row(entry) for entry in result.finalists}
    # What Figs. 5.1 and 5.2 show: how the design that is handed over came about.
    shown = dict.fromkeys(key for key in ("baseline", "colors", "score", last.key) if key in rows)
    stages = {key: {**row, **stage_pictures(pictures, key)} for key, row in rows.items()}
    metric_se = np.stack([entry.metric_se for entry in result.finalists])
    context = {
        "scene": scene.name,
        "scene_hash": scene.hash,
        "title": last.title,
        "lam": f"{result.settings.lam:.4g}",
        "camera": CameraModel.of(scene).sentence,
        "scored": result.objective == "score",
        "warnings": warnings(result),
        "verdict": result.verdict,
        "finalists": [{**row, "best": key == last.key} for key, row in rows.items()],
        "bends": scene.state_titles,
        "word": scene.state_word,
        "sensor": sensor_figure(scene),
        "stages": [stages[key] for key in shown],
        "others": [stage for key, stage in stages.items() if key not in shown],
        "metric_se": f"{np.median(metric_se):.2g}",
        "metric_se_most": f"{metric_se.max():.2g}",
        "bolt": _bolt(result),
        "plots": {
            name: data_uri(pictures[name])
            for name in ("convergence", "scores", "trade")
            if name in pictures
        },
        "color_errors": _color_errors(result),
        "levels": result.trade,
        "scaling": scaling_rows(scaling) if scaling else [],
        "scaling_words": SCALING_WORDS,
        "wiring": wiring_context(
            mounting,
            last.title,
            errors,
            f"For CSV, a drilling jig and other steps: tactilux wiring {DESIGNS}/{last.key}.json.",
            last.rating.read,
        ),
        "replicates": result.replicates,
        "facts": result.facts,
        "steps": [
            ("In the folder of this night:", ""),
            *building_steps(Path(DESIGNS) / f"{last.key}.json", SCENE),
        ],
    }
    return render_page("overnight.html.j2", context)


def _row(entry: Finalist) -> dict[str, str]:
    """Return the figures of one finalist as text."""
    gain = "–"
    if entry.gain is not None and entry.gain_se is not None:
        gain = _pm(entry.gain, entry.gain_se, "+")
    errors = {
        key: _pm(entry.errors[reader].value, entry.errors[reader].se, digits=2) + "°"
        for reader, key in ERROR_KEYS.items()
    }
    return (
        score_row(entry)
        | errors
        | {
            "score": _pm(entry.score, entry.se),
            "gain": gain,
            "predicted": _pm(entry.predicted, entry.predicted_reach),
            "holds": HOLDS[entry.prediction_check],
        }
    )


def _bolt(result: OvernightResult) -> dict[str, Any]:
    """Return Fig. 5.3, or why there is none."""
    head, rows, why_not = BoltHead(), [], ""
    shown = list(dict.fromkeys((result.finalists[0], result.best)))
    try:
        drawn = bolt_pictures(result.scene, [e.design for e in shown], result.settings)
        for entry, pngs in zip(shown, drawn, strict=True):
            rows.append({"title": entry.title, "pictures": [data_uri(png) for png in pngs]})
    except SceneError as error:
        why_not = str(error)
    size = {"radius": f"{2 * head.radius:g}", "depth": f"{head.depth:g}"}
    return {"rows": rows, "why_not": why_not, **size}


def _color_errors(result: OvernightResult) -> str:
    """Say how far the surrogate's facet colors are from the renders, and how noisy those are."""
    colors, noise, predicted = (
        np.concatenate([getattr(entry, name).reshape(-1, 3) for entry in result.finalists])
        for name in ("counts", "counts_se", "predicted_counts")
    )
    length = np.maximum(np.linalg.norm(colors, axis=-1), 0.5)
    error, spread = (np.linalg.norm(e, axis=-1) / length for e in (predicted - colors, noise))
    return (
        f"Colors differ by {np.median(error):.1%} in the median and by up to "
        f"{np.quantile(error, 0.95):.1%} in 95% of cases; the renders' own noise is "
        f"{np.median(spread):.1%} of a color in the median."
    )


def _pm(value: float, half_width: float, sign: str = "", digits: int = 1) -> str:
    """Return value and reach as text that does not break into two lines."""
    return f"{value:{sign}.{digits}f}\u00a0±\u00a0{half_width:.{digits}f}"


WIDTH, HEIGHT = 4.6, 3.4  # inches: text stays readable at the width of a phone
SOFT = "#8a8f98"
MARKS = {
    "baseline": ("#1c1f24", -0.3),
    "the surrogate's best": ("#b45309", -0.15),
    "others": ("#93b4f5", 0.0),
}
"""Tone of the marks of the convergence plot, and where they begin in a step."""


def convergence(result: OvernightResult) -> Figure:
    """Draw every rendered figure step by step, with 95 % intervals and predictions."""
    names = list(dict.fromkeys(point.step for point in result.steps))
    marks = dict.fromkeys(("best", result.winner), "the surrogate's best") | {
        "baseline": "baseline"
    }
    with drawing(WIDTH, HEIGHT) as figure:
        axes = figure.subplots()
        for label, (tone, left) in MARKS.items():
            mine = [point for point in result.steps if marks.get(point.role, "others") == label]
            # Side by side, so that the marks of a step do not cover each other.
            before = [sum(q.step == p.step for q in mine[:i]) for i, p in enumerate(mine)]
            at = [names.index(p.step) + left + 0.1 * b for p, b in zip(mine, before, strict=True)]
            half = [result.interval_factor * point.se for point in mine]
            values = [point.value for point in mine]
            axes.errorbar(at, values, half, fmt="o", ms=4, lw=1, capsize=2, color=tone, label=label)
            axes.plot(at, [point.predicted for point in mine], "x", ms=4.5, mew=1, color=tone)
        axes.plot([], [], "x", ms=4.5, mew=1, color=SOFT, label="predicted")
        for entry, tone in ((result.finalists[0], "#e6e8ec"), (result.best, "#fdebd0")):
            shown = entry.figure(result.objective)
            reach = result.interval_factor * shown.se
            ends = shown.value - reach, shown.value + reach
            axes.axhspan(*ends, lw=0, zorder=0, facecolor=tone)
        ticks = range(0, len(names), -(-len(names) // 6))
        axes.set_xticks(list(ticks), [names[i] for i in ticks])
        axes.set(ylabel=_axis(result), xlim=(-0.5, len(names) - 0.5))
        # An interval that reaches far beyond all scores would press these together.
        both = np.array([(point.value, point.predicted) for point in result.steps])
        least = 1.0 if result.objective == "score" else 0.1
        margin = 0.6 * max(float(np.ptp(both)), least)
        axes.set_ylim(both.min() - margin, both.max() + margin)
        axes.spines[["top", "right"]].set_visible(False)
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False,
                      fontsize=8, columnspacing=1.0, handletextpad=0.3)  # fmt: skip
    return figure


def figure_scatter(result: OvernightResult) -> Figure:
    """Draw predicted against rendered figures of all designs that were rendered."""
    finalists = [entry.figure(result.objective) for entry in result.finalists]
    # The surrogate's own interval is known for S alone.
    scored = result.objective == "score"
    reach = [entry.predicted_reach for entry in result.finalists] if scored else None
    with drawing(WIDTH, HEIGHT) as figure:
        axes = figure.subplots()

        def draw(entries: Sequence[RenderedFigure | ConvergencePoint], **look: Any) -> None:
            half = [result.interval_factor * entry.se for entry in entries]
            axes.errorbar([e.predicted for e in entries], [e.value for e in entries], half, **look)

        draw(result.steps, fmt="o", ms=3.5, lw=0.8, color=SOFT, label="on the way")
        draw(finalists, xerr=reach, fmt="s", ms=5, color="#b45309", label="finalists")
        limits = [*axes.get_xlim(), *axes.get_ylim()]
        axes.plot([min(limits), max(limits)], [min(limits), max(limits)], color=SOFT, lw=0.8)
        axes.spines[["top", "right"]].set_visible(False)
        axes.set(xlabel=f"{_axis(result)}, surrogate", ylabel=f"{_axis(result)}, rendered")
        axes.legend(frameon=False, loc="upper left")
    return figure


def _axis(result: OvernightResult) -> str:
    title = title_of(result.objective)
    return title if result.objective == "score" else f"{title}, deg"


def report_pictures(result: OvernightResult) -> Iterator[tuple[str, bytes]]:
    """Yield ``(name, PNG)``: `design_pictures` of all finalists, and plots."""
    yield from design_pictures(result.scene, result.finalists)
    if result.steps:
        yield "convergence", png_bytes(convergence(result))
    yield "scores", png_bytes(figure_scatter(result))
    if result.trade:
        with drawing(WIDTH, HEIGHT) as figure:
            draw_levels(figure.subplots(), [row[:4] for row in result.trade])
            figure.axes[0].spines[["top", "right"]].set_visible(False)
            yield "trade", png_bytes(figure)
