"""The report of a night: one HTML file that needs nothing else, for screen, phone and paper.

It is made from the files of the finished night alone, and equal files make equal reports.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from optimize.overnight.figures import bolt_pictures, report_pictures, timed_levels
from optimize.overnight.result import Finalist, OvernightResult
from optimize.overnight.scaling import Scaling, load_scaling, scaling_rows, scaling_words
from optimize.report import (
    bend_titles,
    clipping_warning,
    data_uri,
    holder_warning,
    monochrome_warning,
    render_page,
    stage_pictures,
    wiring_sheet,
)
from optimize.scoring import IntervalCheck, check_interval
from render.errors import SceneError
from render.files import write_text
from render.geometry import BoltHead

REPORT = "report.html"
HOLDS = {"holds": "yes", "does not hold": "no", "cannot be tested": "cannot tell"}
STAGES = ("baseline", "colors")
"""What Figs. 5.1 and 5.2 show before the design that is handed over."""


def write_report(result: OvernightResult, run: Path) -> Path:
    """Write ``report.html`` into ``run`` atomically and return its path."""
    path = run / REPORT
    write_text(path, render_report(result, load_scaling(run)))
    return path


def render_report(result: OvernightResult, scaling: Scaling | None = None) -> str:
    """Return the report as HTML with every picture inside as a data URI."""
    return render_page("overnight.html.j2", _context(result, scaling))


def summary(result: OvernightResult) -> list[str]:
    """Return the outcome in words: how much better, where it comes from, who says so."""
    first, last = result.finalists[0], result.finalist(result.winner)
    sentences = []
    if last.gain is not None and last.gain_se is not None:
        low, high = _interval(result, last.gain, last.gain_se)
        sentences.append(
            f"The design scores {_pm(last.score, last.se)}; the baseline scores "
            f"{_pm(first.score, first.se)}. Rendered with the same seeds, the gain is "
            f"{last.gain:.1f} ({last.gain / abs(first.score):+.0%}), and its 95% interval reaches "
            f"from {low:.1f} to {high:.1f}."
        )
    else:
        sentences.append(
            f"Nothing that was rendered beats the baseline, which scores "
            f"{_pm(first.score, first.se)}."
        )
    colors = result.of("colors")
    if (
        last.key not in STAGES
        and colors is not None
        and colors.gain is not None
        and last.gain is not None
        and 0 < colors.gain < last.gain
    ):
        sentences.append(
            f"Of the gain, {colors.gain:+.1f} came with the colors alone, every fiber pointing "
            f"straight in, and {last.gain - colors.gain:+.1f} with the directions."
        )
    before, after = result.rating(first), result.rating(last)
    if last is not first:
        over_bends = (
            f" and over bends from {before.spread_bends:.1f} to {after.spread_bends:.1f}"
            if len(result.scene.bending.angles) > 1
            else ""
        )
        sentences.append(
            f"The mean of the metric went from {before.mean:.1f} to {after.mean:.1f}, its spread "
            f"over sites from {before.spread_sites:.1f} to {after.spread_sites:.1f}{over_bends}."
        )
    checks = [prediction_check(entry) for entry in result.finalists]
    untested = checks.count("cannot be tested")
    sentences.append(
        f"The surrogate said {last.predicted:.1f} for this design; its 90% interval held for "
        f"{checks.count('holds')} of {len(checks)} finalists"
        + (f", and for {untested} of them the renders are too noisy to tell." if untested else ".")
    )
    return sentences


def warnings(result: OvernightResult) -> list[str]:
    """Return what makes the result doubtful, most important first; usually nothing."""
    last, doubts = result.finalist(result.winner), []
    if last.gain is not None and last.gain_se is not None:
        low, high = _interval(result, last.gain, last.gain_se)
        if high < 0:
            doubts.append("The renders say that the baseline is better: this design is not one.")
        elif low <= 0:
            doubts.append(
                "The interval of the gain reaches 0: more hours would make it narrower, and the "
                "same command with more of them goes on from here."
            )
        doubts += holder_warning(result.scene, last.design)
        doubts += monochrome_warning(last.design)
    others = [
        entry
        for entry in result.finalists
        if entry is not last and entry.score > last.score + result.interval_factor * last.se
    ]
    if others:
        doubts.append(
            f"{others[0].title} scored higher in the last renders, at {others[0].score:.1f}."
        )
    return doubts + clipping_warning(last.clipped)


def prediction_check(entry: Finalist) -> IntervalCheck:
    """Return what the renders say of the surrogate's 90 % interval."""
    return check_interval(entry.predicted - entry.score, entry.predicted_reach, entry.se)


def _context(result: OvernightResult, scaling: Scaling | None) -> dict[str, Any]:
    scene, last = result.scene, result.finalist(result.winner)
    pictures = dict(report_pictures(result))
    shown = list(dict.fromkeys([*STAGES, last.key]))
    stages = [entry for key in shown if (entry := result.of(key)) is not None]
    others = [entry for entry in result.finalists if entry not in stages]

    def stage(entry: Finalist) -> dict[str, str]:
        return {**_row(result, entry), **stage_pictures(pictures, entry.key)}

    metric_se = np.stack([entry.metric_se for entry in result.finalists])
    return {
        "scene": scene.name,
        "scene_hash": scene.hash,
        "title": last.title,
        "lam": f"{result.settings.lam:.4g}",
        "summary": summary(result),
        "warnings": warnings(result),
        "verdict": result.verdict,
        "finalists": [{**_row(result, entry), "best": entry is last} for entry in result.finalists],
        "bends": bend_titles(scene),
        "stages": [stage(entry) for entry in stages],
        "others": [stage(entry) for entry in others],
        "metric_se": f"{np.median(metric_se):.2g}",
        "metric_se_most": f"{metric_se.max():.2g}",
        "bolt": _bolt(result),
        "plots": {
            name: data_uri(pictures[name])
            for name in ("convergence", "scores", "colors", "trade")
            if name in pictures
        },
        "color_errors": _color_errors(result),
        "levels": [_level(row) for row in timed_levels(result)],
        "scaling": scaling,
        "scaling_rows": scaling_rows(scaling) if scaling else [],
        "scaling_note": scaling_words(scaling) if scaling else "",
        "wiring": wiring_sheet(scene, last.design, last.title, pictures[f"scheme-{last.key}"]),
        "replicates": result.replicates,
        "facts": result.facts,
    }


def _row(result: OvernightResult, entry: Finalist) -> dict[str, str]:
    """Return the figures of one finalist as text."""
    rating = result.rating(entry)
    gain = ""
    if entry.gain is not None and entry.gain_se is not None:
        gain = _pm(entry.gain, entry.gain_se, "+")
    return {
        "title": entry.title,
        "score": _pm(entry.score, entry.se),
        "interval": f"{rating.interval[0]:.1f} to {rating.interval[1]:.1f}",
        "gain": gain or "–",
        "predicted": _pm(entry.predicted, entry.predicted_reach),
        "holds": HOLDS[prediction_check(entry)],
        "mean": f"{rating.mean:.1f}",
        "spread_sites": f"{rating.spread_sites:.1f}",
        "spread_bends": f"{rating.spread_bends:.1f}",
        "clipped": f"{entry.clipped:.1%}" if entry.clipped else "none",
    }


def _bolt(result: OvernightResult) -> dict[str, Any]:
    """Return Fig. 5.3, or why there is none."""
    head = BoltHead()
    try:
        drawn = bolt_pictures(result)
    except SceneError as error:
        return {"rows": [], "titles": [], "why_not": str(error)}
    keys = list(dict.fromkeys(key for key, _ in drawn))
    return {
        "titles": [result.finalist(key).title for key in keys],
        "rows": [
            {
                "bend": bend,
                "pictures": [
                    {"title": result.finalist(key).title, "data": data_uri(drawn[key, index])}
                    for key in keys
                ],
            }
            for index, bend in enumerate(bend_titles(result.scene))
        ],
        "radius": f"{2 * head.radius:g}",
        "depth": f"{head.depth:g}",
    }


def _color_errors(result: OvernightResult) -> str:
    """Say how far the surrogate's facet colors are from the renders, and how noisy those are."""
    off, noise, lit = [], [], 0.5
    for entry in result.finalists:
        length = np.maximum(np.linalg.norm(entry.counts, axis=-1), lit)
        off.append(np.linalg.norm(entry.predicted_counts - entry.counts, axis=-1) / length)
        noise.append(np.linalg.norm(entry.counts_se, axis=-1) / length)
    error, spread = np.concatenate(off).ravel(), np.concatenate(noise).ravel()
    return (
        f"Colors differ by {np.median(error):.1%} in the median and by up to "
        f"{np.quantile(error, 0.95):.1%} in 95% of cases; the renders' own noise is "
        f"{np.median(spread):.1%} of a color in the median."
    )


def _level(row: dict[str, float | str | None]) -> dict[str, str]:
    def text(key: str, form: str) -> str:
        value = row.get(key)
        return "–" if value is None else format(value, form)

    return {
        "level": str(row["level"]),
        "seconds": text("seconds_per_design", ".2g"),
        "median": text("facet_error_median", ".1%"),
        "p95": text("facet_error_p95", ".1%"),
        "score": text("score_error", ".2f"),
        "tau": text("kendall_tau", ".2f"),
    }


def _interval(result: OvernightResult, value: float, se: float) -> tuple[float, float]:
    return value - result.interval_factor * se, value + result.interval_factor * se


def _pm(value: float, half_width: float, sign: str = "") -> str:
    """Return value and reach as text that does not break into two lines."""
    return f"{value:{sign}.1f}\u00a0±\u00a0{half_width:.1f}"
