"""The report of an exploration: one HTML file that needs nothing else, for screen and paper.

It is written together with designs and pictures, all at once or not at all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import IO, Any, Protocol

from optimize.design import PARTS, Design, Rating, keep_scene, kept_name, noise_words, save_design
from optimize.exploration import Exploration, Stage, rate
from optimize.mounting import empty_places, mount, mounting_error_costs, surrogate_score
from optimize.objectives import ERROR_KEYS, ObjectiveName
from optimize.placement import moved_lamps
from optimize.play import PlayPage, write_play
from optimize.readers import JSON_NAMES, CameraModel, compare_readings
from optimize.report.illustrations import camera_pictures, convergence, design_pictures, png_bytes
from optimize.report.page import (
    building_steps,
    built_steps,
    clipping_warning,
    data_uri,
    depth_steps,
    guessing_warning,
    holder_warning,
    monochrome_warning,
    picture_kind,
    preview_warnings,
    render_page,
    sensor_figure,
    stage_pictures,
    verification_steps,
)
from optimize.report.wiring import wiring_context, wiring_files, write_wiring
from optimize.ui.console import counted, note, print_table
from optimize.ui.output import fresh_directory, write_manifest
from optimize.ui.provenance import package_versions
from render.errors import RenderError, TableError
from render.files import write_bytes, write_text
from render.levels import NETWORK, RIDGE, TABLE
from render.scene import Scene, StandaloneScene
from surrogate.runtime import Checker, RankingTest, sha256

DESIGN, BASELINE, REPORT, PLAY = "design.json", "baseline.json", "report.html", "play.html"
LEGEND = (
    "Readers: degrees by which they miss surface normals; sensor: one smooth map for the whole "
    "sensor; place: a lookup that knows every place. S = mean M - spreads, in counts of 255 "
    "(higher is better); M: how bright and how differently colored the facets of a contact are. "
    "More: docs/score.md, and the report."
)


def write_exploration(
    exploration: Exploration,
    kept: StandaloneScene,
    target: Path,
    elapsed: Callable[[], float],
    *,
    keep_other: bool = True,
) -> dict[str, object]:
    """Write everything into ``target`` and return the result for programs.

    ``kept`` is the scene's file as it was read; a copy is kept with the designs.

    An earlier result in ``target`` is replaced; where it found another design it is kept under a
    number, unless ``keep_other`` says not to. ``elapsed`` returns the seconds since the command
    began.
    """
    scene, first, last = exploration.scene, exploration.stages[0], exploration.stages[-1]
    with fresh_directory(target, keep=DESIGN if keep_other else "") as folder:
        keep_scene(folder, kept)
        save_design(folder / BASELINE, first.design, scene, first.rating)
        save_design(folder / DESIGN, last.design, scene, last.rating)
        pictures = dict(explore_pictures(exploration))
        for name, content in pictures.items():
            write_bytes(folder / f"{name}.{picture_kind(content)}", content)
        checker = exploration.checker
        mounting = mount(scene, last.design, surrogate_score(checker, scene))
        mounted = rate(checker, scene, "mounted", "As mounted", "", mounting.design)
        no_jig = write_wiring(folder, mounting, mounted.rating)
        html = render_report(
            exploration.stages,
            pictures,
            ranking=exploration.ranking,
            objective=exploration.objective,
            wiring=wiring_context(
                mounting,
                last.title,
                mounting_error_costs(checker, scene, mounting.design),
                wiring_files(target / DESIGN, no_jig),
                mounted.rating.read,
            ),
            confidence=f"{exploration.checker.coverage:.0%}",
            search_note=_search_note(exploration),
            caveats=caveats(exploration),
            facts=_facts(exploration, elapsed()),
            errors=exploration.checker.metadata.held_out,
            made=datetime.now(UTC).strftime("%d %B %Y, %H:%M UTC"),
            steps=[
                *verification_steps(target / DESIGN, kept_name(kept, target), checker.effort),
                *depth_steps(scene, target / DESIGN),
                *(built_steps(target / DESIGN) if empty_places(scene, last.design).any() else ()),
                *building_steps(target / DESIGN, kept_name(kept, target)),
            ],
            play=_write_play(exploration, folder),
        )
        write_text(folder / REPORT, html)
        result = exploration.to_json(target / DESIGN, target / REPORT, elapsed())
        result["warnings"] = warnings(
            exploration.stages, exploration.ranking, exploration.objective
        )
        write_manifest(folder, result)
    return result


def _write_play(exploration: Exploration, folder: Path) -> str:
    """Write the page to play with; return its name, empty where there is none of the scene."""
    design = exploration.design
    page = PlayPage(
        exploration.scene,
        exploration.checker,
        start=design,
        optimum=design,
        objective=exploration.objective,
    )
    try:
        write_play(folder / PLAY, page)
    except (TableError, RenderError) as error:
        note(f"There is no page to play with: {error}")
        return ""
    return PLAY


def caveats(exploration: Exploration) -> list[str]:
    """Return what the reader must know before believing the numbers."""
    checker = exploration.checker
    through = "" if exploration.scene.diffuser is None else "through the diffuser "
    origin = f"All scores come from the {checker.level_name}: "
    if checker.metadata.rendered:
        corrected = checker.effort in (RIDGE, NETWORK, TABLE)
        origin += "the preview, corrected by " if corrected else "light that was held against "
        origin += "physically based renders of this sensor. It has not seen this design."
    else:
        if checker.effort is not None:
            origin += f"the preview, corrected by light that was traced {through}to every facet; "
        origin += "nothing was rendered for this sensor. Its errors were measured on other sensors "
        origin += "of the family, and are those below."
    return [
        origin,
        f"The intervals held {checker.coverage:.0%} of held-out random designs, within "
        f"{checker.score_half_width:.2f} counts of the reference's score. A search picks the best "
        f"of many candidates and so finds the {checker.level}'s mistakes too: the true gain is "
        "likely to be smaller than shown.",
        f"Both baseline and optimized design share the {checker.level}'s errors in part, so the "
        "interval of their difference is not the sum of the two; only a verification gives it.",
        CameraModel.of(exploration.scene).sentence,
        "The scene is the one described by its file. Values marked as assumed there (see "
        "tactilux describe) have not been calibrated against a real sensor.",
    ]


def _search_note(exploration: Exploration) -> str:
    search = exploration.search
    end = (
        "until a round moved nothing"
        if search.converged
        else "until the rounds ran out, so a longer search may find more"
    )
    rounds = counted(search.history[-1].round, "round")
    return (
        f"{counted(search.evaluated, 'design')} in {search.seconds:.1f} s: {rounds} of colors"
        f"{' and directions' if any(exploration.scene.turning) else ''}, {end}."
        f"{f' {exploration.proof}' if exploration.proof else ''}"
    )


def _facts(exploration: Exploration, seconds: float) -> list[tuple[str, str]]:
    scene, about = exploration.scene, exploration.checker.metadata
    first = exploration.stages[0]
    titles = {stage.key: stage.title for stage in exploration.stages}
    versions = package_versions("numpy", "onnxruntime", "cma", "moderngl")
    return [
        ("Scene", f"{scene.name}, {scene.hash}"),
        ("Level", first.rating.level_name + noise_words(first.photon_noise)),
        ("Seed", str(exploration.seed)),
        ("Time", f"{seconds:.1f} s"),
        ("Exposure, λ", f"{about.exposure:.6g}, {about.lam:.6g}"),
        *_model_facts(exploration.checker),
        ("Versions", ", ".join(f"{name} {version}" for name, version in versions.items())),
        *(exploration.study.facts(titles) if exploration.study else ()),
    ]


def _model_facts(checker: Checker) -> list[tuple[str, str]]:
    if checker.file is None:
        return []
    return [
        ("Model", f"{checker.file}, SHA-256 {sha256(checker.file.read_bytes())}"),
        ("Training data", f"SHA-256 {checker.metadata.training_data_hash}"),
        ("Model's sources", checker.metadata.git_revision),
    ]


def explore_pictures(exploration: Exploration) -> Iterator[tuple[str, bytes]]:
    """Yield pictures by name: schemes, heat maps and facets of all stages, previews, convergence.

    Preview pictures are made for the first and the last stage, at every bend; brightness is
    exposed as the scene's camera is, so that pictures can be compared.
    """
    scene, stages = exploration.scene, exploration.stages
    yield from design_pictures(scene, stages)
    yield "convergence", png_bytes(convergence(exploration.search.history))
    yield from camera_pictures(scene, (stages[0], stages[-1]))


def render_report(
    stages: Sequence[Stage],
    pictures: Mapping[str, bytes],
    *,
    ranking: RankingTest,
    objective: ObjectiveName = "score",
    **texts: Any,
) -> str:
    """Return the report as HTML with every picture inside as a data URI.

    Arguments:
        stages: baseline first, the result last.
        pictures: PNG or SVG by name: ``scheme-<stage>``, ``metric-<stage>``, ``facets-<stage>``,
            ``preview-<stage>-<bend index>`` (baseline and result, or none) and ``convergence``.
        ranking: whether the model can rank designs.
        objective: what was searched for.
        texts: what else the template shows: ``confidence`` (coverage of the intervals),
            ``search_note``, ``caveats``, ``facts`` (origin of the numbers), ``errors`` (rows of the
            model's held-out errors, as in its metadata), ``made``, ``steps`` (what to do next) and
            ``wiring`` (see `wiring_context`), and ``play``, the page to play with beside the
            report, or nothing.
    """
    first, result = stages[0], stages[-1]
    scene, bends = first.scene, first.scene.state_titles
    context = {
        "scene": scene.name,
        "scene_hash": scene.hash,
        "level": first.rating.level_name,
        "lam": f"{first.settings.lam:.4g}",
        "summary": summary(stages, ranking, objective),
        "warnings": warnings(stages, ranking, objective),
        "bends": bends,
        "word": scene.state_word,
        "sensor": sensor_figure(scene),
        "stages": [{**_row(stage), **stage_pictures(pictures, stage.key)} for stage in stages],
        "previews": [
            {
                "title": stage.title,
                "pictures": [
                    {"bend": bend, "data": data_uri(pictures[f"preview-{stage.key}-{index}"])}
                    for index, bend in enumerate(bends)
                ],
            }
            for stage in ((first, result) if f"preview-{first.key}-0" in pictures else ())
        ],
        "convergence": data_uri(pictures["convergence"]),
    }
    return render_page("report.html.j2", context | texts)


class Scored(Protocol):
    """A design with its rating, for a table."""

    @property
    def title(self) -> str:
        """What it is called."""

    @property
    def rating(self) -> Rating:
        """Its score."""

    @property
    def clipped(self) -> float:
        """Fraction of its facets that saturate."""


def print_scores(stream: IO[str], stages: Sequence[Stage], coverage: float) -> None:
    """Print the figures of ``stages``, of one scene or several; ``coverage`` of their intervals."""
    columns = {
        "title": "design",
        "sensor": "sensor",
        "reader_error": "sensor reader",
        "normal_error": "place reader",
        "score": "score S",
        "interval": f"{coverage:.0%} interval",
    }
    scenes = {stage.scene.hash: stage.scene.name for stage in stages}
    if len(scenes) == 1:
        del columns["sensor"]
    rows = [_row(stage) | {"sensor": stage.scene.name} for stage in stages]
    print_table(
        stream,
        f"{', '.join(f'{name}, {key}' for key, name in scenes.items())}, "
        f"{stages[0].rating.level_name}{noise_words(stages[0].photon_noise)}",
        list(columns.values()),
        [[row[key] for key in columns] for row in rows],
        below=LEGEND,
    )


def _row(stage: Stage) -> dict[str, str]:
    return {**score_row(stage), **degrees_row(stage)}


def degrees_row(stage: Stage) -> dict[str, str]:
    """Return the mean errors of both readers as text, shared by reports and tables."""
    row = {}
    for reader, key in ERROR_KEYS.items():
        known = stage.rendered.get(reader)
        row[key] = f"{stage.error(reader):.2f}°" + (f" ± {known.se:.2f}" if known else "")
    return row


def score_row(stage: Scored) -> dict[str, str]:
    """Return the figures of one design as text, shared by the report and the terminal table."""
    rating = stage.rating
    low, high = rating.interval
    return {
        "title": stage.title,
        "interval": f"{low:.1f} to {high:.1f}",
        **{part: f"{getattr(rating, part):.1f}" for part in PARTS},
        "clipped": f"{stage.clipped:.1%}" if stage.clipped else "none",
    }


def doubted_gain(design: Design, ranking: RankingTest | None) -> str:
    """Return why a better score of ``design`` is not a gain; usually nothing.

    ``ranking`` is that of the model which scored it, None where it was rendered.
    """
    if ranking is not None and not ranking.reliable:
        return "the model has not shown that it can rank designs"
    return "one color lights everything, which tells no azimuth" if design.monochrome else ""


def summary(
    stages: Sequence[Stage], ranking: RankingTest, objective: ObjectiveName = "score"
) -> list[str]:
    """Return the outcome in words: how much better, where it comes from, how sure it is.

    One color everywhere, or a model that cannot rank designs, is not called a gain.
    """
    if objective != "score":
        return reader_summary(stages, objective)
    first, last = stages[0].rating, stages[-1].rating
    gain = last.score - first.score
    doubt = doubted_gain(stages[-1].design, ranking)
    if doubt:
        return [
            f"The {first.level} says {last.score:.1f} for the optimized design and "
            f"{first.score:.1f} for the baseline, but {doubt}: this is not a gain."
        ]
    sentences = [
        f"The optimized design scores {last.score:.1f}; the baseline scores {first.score:.1f}, "
        f"so the {first.level} predicts a gain of {gain:.1f} ({gain / abs(first.score):+.0%})."
    ]
    sentences.append(
        f"One reader for the whole sensor misses surface normals by {stages[-1].reader_error:.2f}° "
        f"on average; with the baseline, by {stages[0].reader_error:.2f}°."
    )
    steps = [
        f"{late.rating.score - early.rating.score:+.1f} by {late.change}"
        for early, late in pairwise(stages)
    ]
    moves = parts_moved(stages[0].scene, first, last)
    sentences.append(f"Of that, {' and '.join(steps)}. {moves}")
    return sentences


def reader_summary(stages: Sequence[Stage], objective: ObjectiveName) -> list[str]:
    """Return in words what a search for the degrees of a reader found."""
    first, last = stages[0], stages[-1]
    errors = {
        "sensor": (last.reader_error, first.reader_error),
        "place": (last.normal_error, first.normal_error),
    }
    after, before = errors.pop(objective)
    ((other, (then, earlier)),) = errors.items()
    placed = empty_places(last.scene, last.design).any()
    return [
        f"The {objective} reader misses surface normals by {after:.2f}° on average; with the "
        f"baseline, by {before:.2f}° ({after / before - 1.0:+.0%}), as the {first.rating.level} "
        "has it.",
        f"The {other} reader misses them by {then:.2f}°; with the baseline, by {earlier:.2f}°.",
        *([f"{moved_lamps(last.scene, last.design)}."] if placed else []),
        f"S is {last.rating.score:.1f}; that of the baseline is {first.rating.score:.1f}.",
    ]


def parts_moved(scene: Scene, first: Rating, last: Rating) -> str:
    """Return how the parts of the score went from one rating to another, in one sentence."""
    word = scene.state_word
    over = f" and over {word}s from {first.spread_bends:.1f} to {last.spread_bends:.1f}"
    return (
        f"The mean of the metric went from {first.mean:.1f} to {last.mean:.1f}, its spread over "
        f"sites from {first.spread_sites:.1f} to {last.spread_sites:.1f}{over if word else ''}."
    )


def warnings(
    stages: Sequence[Stage], ranking: RankingTest, objective: ObjectiveName = "score"
) -> list[str]:
    """Return what makes the result doubtful, most important first; usually nothing."""
    if objective != "score":
        return reader_warnings(stages, ranking, objective)
    texts = [] if ranking.reliable else [ranking.advice()]
    first, last = stages[0], stages[-1]
    if last.rating.score <= first.rating.score:
        texts.append("The search found nothing better than the baseline.")
    elif last.rating.interval[0] <= first.rating.interval[1]:
        texts.append(
            "The intervals of baseline and optimized design overlap: at this level the gain is "
            "not certain, and only a verification can tell."
        )
    if last.rating.score > first.rating.score and last.reader_error > first.reader_error:
        texts.append(
            f"S rose, but normals are read worse, off by {last.reader_error:.2f}° instead of "
            f"{first.reader_error:.2f}°: the score misleads here (docs/score.md says by what)."
        )
    return texts + design_warnings(last)


def reader_warnings(
    stages: Sequence[Stage], ranking: RankingTest, objective: ObjectiveName
) -> list[str]:
    """Return what makes a design doubtful that a search for a reader's degrees found."""
    first, last = stages[0], stages[-1]
    texts = [] if ranking.reliable else [ranking.advice()]
    if last.digest == first.digest:
        texts.append(
            f"The search found nothing that the {objective} reader reads better than the baseline: "
            "the baseline is handed over."
        )
    elif objective != "score" and not last.rendered:
        gain = compare_readings(first.reading, last.reading)[f"{JSON_NAMES[objective]}_mean"]
        low, high = gain.interval
        if high >= 0.0:
            texts.append(
                f"The {first.rating.level} may be off by more than the {objective} reader gains: "
                f"{gain.difference:+.2f}°, {low:+.2f}° to {high:+.2f}°."
            )
    return texts + design_warnings(last)


def design_warnings(last: Stage) -> list[str]:
    """Return what is doubtful about one design, whatever it was compared with."""
    texts = preview_warnings(last.scene, last.rating.level, last.photon_noise)
    texts += guessing_warning(last.scene, last.reader_error)
    texts += holder_warning(last.scene, last.design)
    texts += monochrome_warning(last.design)
    if last.domain_excess > 0:
        texts.append(
            f"The optimized design lies outside the range that the surrogate was trained on "
            f"(excess {last.domain_excess:.2g}): its score is an extrapolation."
        )
    return texts + clipping_warning(last.clipped)
