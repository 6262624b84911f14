"""The frontier over many scenes: each measured by itself, and what all of them say of a rung.

A scene that is finished is kept with what was asked, and taken as it is when the same is asked
again; renders of an unfinished one go on. So a survey that is stopped goes on scene by scene.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from optimize.frontier.frontier import Frontier
from optimize.frontier.held_out import FrontierRow
from render.errors import SceneError, TactiluxError
from render.files import read_sealed, write_json
from render.scene import Scene, load_scene

KEPT = "frontier.json"
"""Of a scene: its frontier, beside what was asked."""


@dataclass(frozen=True)
class SceneFrontier:
    """The frontier of one scene as a survey keeps it.

    Arguments:
        scene: its name.
        asked: what the rows answer: scene hash, seed, designs, effort and version.
        rows: from quick to slow.
        noise: what a perfect level would show.
        left_out: why the scene lacks a level, by its name.
        samples: per fiber and facet, of its reference; 0 where it failed.
        seconds: all that it took.
        failed: why it has no rows; "" where it has.
    """

    scene: str
    asked: dict[str, Any]
    rows: list[FrontierRow]
    noise: FrontierRow | None
    left_out: dict[str, str]
    samples: int
    seconds: float
    failed: str = ""

    @classmethod
    def of(cls, found: Frontier, asked: dict[str, Any], seconds: float) -> SceneFrontier:
        """Return what is kept of a measured frontier."""
        return cls(
            scene=found.reference.designs.scene.name,
            asked=asked,
            rows=list(found.rows),
            noise=found.noise,
            left_out=found.left_out,
            samples=found.plan.samples,
            seconds=seconds,
        )


@dataclass(frozen=True)
class RungSummary:
    """One rung over all scenes that have it.

    Arguments:
        rung: its name.
        scenes: how many have it.
        ready_seconds: until it predicts its first design, median over scenes.
        seconds_per_design: of the next ones, median.
        facet_median, facet_worst: error of facet colors without the reference's noise, the median
            over facets: its median over scenes, and the largest.
        kendall_tau, noise_tau: medians; the second is what noise alone leaves of a perfect level
            at least.
        score_coverage: fraction of all scores that the rung's 90 % intervals held; None without.
        half_width: of these intervals, median, counts.
    """

    rung: str
    scenes: int
    ready_seconds: float
    seconds_per_design: float
    facet_median: float
    facet_worst: float
    kendall_tau: float
    noise_tau: float
    score_coverage: float | None
    half_width: float | None


@dataclass(frozen=True)
class Survey:
    """The frontiers of several scenes."""

    scenes: tuple[SceneFrontier, ...]

    def summary(self) -> list[RungSummary]:
        """Return one line for every rung, in the order in which scenes have them."""
        rungs = dict.fromkeys(row.rung for scene in self.scenes for row in scene.rows)
        return [self._summary(rung) for rung in rungs]

    def _summary(self, rung: str) -> RungSummary:
        pairs = [(row, s.noise) for s in self.scenes for row in s.rows if row.rung == rung]
        rows = [row for row, _ in pairs]
        held = [row.interval for row in rows if row.interval is not None]
        errors = [row.facet_median_true for row in rows]
        return RungSummary(
            rung=rung,
            scenes=len(rows),
            ready_seconds=_median([row.setup_seconds + row.seconds_per_design for row in rows]),
            seconds_per_design=_median([row.seconds_per_design for row in rows]),
            facet_median=_median(errors),
            facet_worst=max(errors),
            kendall_tau=_median([row.kendall_tau for row in rows]),
            noise_tau=_median([noise.kendall_tau for _, noise in pairs if noise is not None]),
            score_coverage=float(np.mean([one.score for one in held])) if held else None,
            half_width=_median([one.half_width for one in held]) if held else None,
        )

    def to_json(self) -> dict[str, object]:
        """Return what programs rely on."""
        return {
            "rungs": [asdict(rung) for rung in self.summary()],
            "scenes": [asdict(scene) for scene in self.scenes],
        }


def surveyed_scenes(names: Sequence[str]) -> dict[str, Scene]:
    """Return the scenes of ``names`` by their own: shipped ones, files, and all of a folder.

    Raises:
        SceneError: all files that are no scene at once; no file in a folder; two scenes of a name.
    """
    found: dict[str, Scene] = {}
    problems: list[str] = []
    for name in names:
        folder = Path(name)
        files = sorted(folder.glob("*.toml")) if folder.is_dir() else [name]
        if not files:
            problems.append(f"{name} holds no scene, allowed: a folder with .toml files")
        for file in files:
            try:
                scene = load_scene(file)
            except SceneError as error:
                problems.append(str(error))
                continue
            if scene.name in found:
                problems.append(
                    f"{file} is a second scene of the name {scene.name}, allowed: one of each; "
                    "rename it"
                )
            found[scene.name] = scene
    if problems:
        raise SceneError("; ".join(problems), field="scene")
    return found


def survey(
    scenes: dict[str, Scene],
    folder: Path,
    asked: Callable[[Scene], dict[str, Any]],
    measure: Callable[[Scene, Path], Frontier],
    clock: Callable[[], float],
    begin: Callable[[str, int], None],
) -> Survey:
    """Measure scene after scene; each is kept in a folder of its name in ``folder``.

    Arguments:
        scenes: by name.
        folder: of the survey.
        asked: what a frontier of a scene answers, as JSON holds it: kept ones answer the same.
        measure: makes the frontier of a scene in its folder.
        clock: seconds.
        begin: is told of every scene that is measured now, and how many are to come after it.

    A scene that cannot be measured has the error's sentence instead of rows.
    """
    done: list[SceneFrontier] = []
    for number, (name, scene) in enumerate(scenes.items(), 1):
        own, wanted = folder / name, asked(scene)
        kept = _kept(own / KEPT, wanted)
        if kept is None:
            begin(name, len(scenes) - number)
            began = clock()
            try:
                kept = SceneFrontier.of(measure(scene, own), wanted, clock() - began)
            except TactiluxError as error:
                done.append(
                    SceneFrontier(name, wanted, [], None, {}, 0, clock() - began, str(error))
                )
                continue
            write_json(own / KEPT, asdict(kept))
        done.append(kept)
    return Survey(tuple(done))


def _kept(path: Path, wanted: dict[str, Any]) -> SceneFrontier | None:
    try:
        kept = TypeAdapter(SceneFrontier).validate_python(read_sealed(path))
    except (OSError, ValueError):  # none yet, or damaged: then it is made
        return None
    return kept if kept.asked == wanted else None


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))
