"""The report of an exploration: one HTML file that needs nothing else, for screen and paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from optimize.exploration.stages import Stage
from optimize.report.page import (
    bend_titles,
    clipping_warning,
    data_uri,
    monochrome_warning,
    render_page,
    stage_pictures,
    wiring_sheet,
)
from render.scene.schema import Scene


@dataclass(frozen=True)
class ReportContent:
    """Everything that the report shows, before it is laid out.

    Arguments:
        stages: baseline first, the result last.
        pictures: PNG bytes by name: ``scheme-<stage>``, ``metric-<stage>``, ``facets-<stage>``,
            ``preview-<stage>-<bend index>`` (baseline and result) and ``convergence``.
        confidence: coverage of the intervals, as text.
        search_note: what the search did, in one sentence.
        caveats: what the reader must know before believing the numbers.
        facts: origin of the numbers, in the order shown.
        errors: rows of the model's held-out errors, as in its metadata.
    """

    scene: Scene
    stages: Sequence[Stage]
    pictures: Mapping[str, bytes]
    confidence: str
    search_note: str
    caveats: Sequence[str]
    facts: Sequence[tuple[str, str]]
    errors: Sequence[Mapping[str, Any]]
    made: str
    verify_command: str


def render_report(content: ReportContent) -> str:
    """Return the report as HTML with every picture inside as a data URI."""
    return render_page("report.html.j2", _context(content))


def score_row(stage: Stage) -> dict[str, str]:
    """Return the figures of one design as text, shared by the report and the terminal table."""
    rating = stage.rating
    low, high = rating.interval
    return {
        "title": stage.title,
        "score": f"{rating.score:.1f}",
        "interval": f"{low:.1f} to {high:.1f}",
        "mean": f"{rating.mean:.1f}",
        "spread_sites": f"{rating.spread_sites:.1f}",
        "spread_bends": f"{rating.spread_bends:.1f}",
        "clipped": f"{stage.clipped:.1%}" if stage.clipped else "none",
        "level": rating.level,
    }


def summary(stages: Sequence[Stage]) -> list[str]:
    """Return the outcome in words: how much better, where it comes from, how sure it is."""
    first, last = stages[0].rating, stages[-1].rating
    gain = last.score - first.score
    sentences = [
        f"The optimized design scores {last.score:.1f}; the baseline scores {first.score:.1f}, "
        f"so the surrogate predicts a gain of {gain:.1f} ({gain / abs(first.score):+.0%})."
    ]
    steps = [
        f"{late.rating.score - early.rating.score:+.1f} by {late.change}"
        for early, late in pairwise(stages)
    ]
    sentences.append(
        f"Of that, {' and '.join(steps)}. The mean of the metric went from {first.mean:.1f} to "
        f"{last.mean:.1f}, its spread over sites from {first.spread_sites:.1f} to "
        f"{last.spread_sites:.1f} and over bends from {first.spread_bends:.1f} to "
        f"{last.spread_bends:.1f}."
    )
    return sentences


def warnings(stages: Sequence[Stage]) -> list[str]:
    """Return what makes the result doubtful, most important first; usually nothing."""
    found = []
    first, last = stages[0], stages[-1]
    if last.rating.score <= first.rating.score:
        found.append("The search found nothing better than the baseline.")
    elif last.rating.interval[0] <= first.rating.interval[1]:
        found.append(
            "The intervals of baseline and optimized design overlap: at this level the gain is "
            "not certain, and only a verification can tell."
        )
    found += monochrome_warning(last.design)
    if last.domain_excess > 0:
        found.append(
            f"The optimized design lies outside the range that the surrogate was trained on "
            f"(excess {last.domain_excess:.2g}): its score is an extrapolation."
        )
    return found + clipping_warning(last.clipped)


def _context(content: ReportContent) -> dict[str, Any]:
    scene, pictures = content.scene, content.pictures
    bends, result = bend_titles(scene), content.stages[-1]
    ends = [content.stages[0], result]
    return {
        "scene": scene.name,
        "scene_hash": scene.hash,
        "made": content.made,
        "level": "surrogate",
        "confidence": content.confidence,
        "lam": f"{content.stages[0].rating.lam:.4g}",
        "summary": summary(content.stages),
        "warnings": warnings(content.stages),
        "bends": bends,
        "stages": [
            {**score_row(stage), **stage_pictures(pictures, stage.key)} for stage in content.stages
        ],
        "previews": [
            {
                "title": stage.title,
                "pictures": [
                    {"bend": bend, "data": data_uri(pictures[f"preview-{stage.key}-{index}"])}
                    for index, bend in enumerate(bends)
                ],
            }
            for stage in ends
        ],
        "convergence": data_uri(pictures["convergence"]),
        "search_note": content.search_note,
        "wiring": wiring_sheet(
            scene, result.design, result.title, pictures[f"scheme-{result.key}"]
        ),
        "caveats": content.caveats,
        "verify_command": content.verify_command,
        "facts": content.facts,
        "errors": [_error_row(row) for row in content.errors],
    }


def _error_row(row: Mapping[str, Any]) -> dict[str, str]:
    return {
        "level": str(row["level"]),
        "facet_median": f"{row['facet_median']:.1%}",
        "facet_p95": f"{row['facet_p95']:.1%}",
        "score_median": f"{row['score_median']:.2f}",
        "score_p95": f"{row['score_p95']:.2f}",
        "kendall_tau": f"{row['kendall_tau']:.2f}",
    }
