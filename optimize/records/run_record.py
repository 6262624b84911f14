"""One run as its own files tell of it: a reader per kind, and one sentence for what is damaged.

Nothing is computed again, and no record is believed beyond what it says: a file that lacks what its
kind must have makes the run *damaged*, which is told with the reason.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from optimize.design import SCENE, Design, design_digest, load_design_file
from optimize.design.design_file import DesignFile
from optimize.dimensions.study_page import PAGE
from optimize.objectives import ERROR_KEYS, ReaderName
from optimize.overnight.result import DESIGNS, NIGHT, OvernightResult
from optimize.overnight.run_directory import LOG, RECORD, RunError
from optimize.overnight.run_directory import REPORT as NIGHT_REPORT
from optimize.overnight.status import status_of
from optimize.report import DESIGN, PLAY, REPORT
from optimize.ui.console import duration
from optimize.ui.output import MANIFEST
from render.errors import SceneError, TactiluxError
from render.files import parse_json, read_bytes, read_sealed
from render.levels import REFERENCE, level_name, read_level
from render.refused_values import problem_sentence
from render.scene import load_scene
from surrogate.runtime import Checker
from surrogate.runtime.model_file import CARD_FILE, MODEL_FILE, sha256

KINDS = ("explore", "study", "verify", "optimize", "overnight", "train", "play")
STATES = ("finished", "running", "stopped", "lost", "failed", "unfinished", "damaged")
"""All but the first two and the last go on by the same command, see `RunStatus` for nights."""
VERIFIED = re.compile(r"verified-[0-9a-f]{12}\.json")
PAGE_SEAL = re.compile(rb"<!-- seal ([0-9a-f]{64}) -->\n?\Z")
PAGE_SEALED = re.compile(rb"<!-- seal|[0-9a-f]{64} -->")
"""What shows of it, whichever of its bits is turned; earlier pages have none."""
PLAY_FACTS = re.compile(rb'<script type="application/json" id="page">(.*?)</script>', re.DOTALL)


@dataclass(frozen=True, eq=False)
class RunRecord:
    """What is known of a run.

    Arguments:
        kind: the command that made it, one of `KINDS`.
        path: its folder, or its file where it is one.
        time: when its record was written, seconds since 1970.
        state: one of `STATES`.
        scene, scene_hash, level: empty where the record does not say; effort: None there.
        score: of the design that it hands over, in counts.
        interval: of ``score``: 90 % on models and previews, 95 % from renders.
        errors: degrees that readers miss with that design, by reader; none where nobody has read.
        design: file of that design; lights: the design itself.
        report: what to open; play: a page to play with beside it.
        note: what else its record says, or what is wrong with it.
    """

    kind: str
    path: Path
    time: float
    state: str = "finished"
    scene: str = ""
    scene_hash: str = ""
    level: str = ""
    effort: str | None = None
    score: float | None = None
    interval: tuple[float, float] | None = None
    errors: Mapping[ReaderName, float] = field(default_factory=dict)
    design: Path | None = None
    lights: Design | None = None
    report: Path | None = None
    play: Path | None = None
    note: str = ""

    @property
    def level_name(self) -> str:
        """Level and effort as people read them; empty where the record does not say."""
        return level_name(self.level, self.effort)


def read_record(kind: str, path: Path) -> RunRecord:
    """Return the run of ``kind`` in ``path``; damaged, with the reason, where it cannot be read."""
    readers: dict[str, Callable[[Path], RunRecord]] = {
        "explore": lambda folder: _result("explore", folder),
        "optimize": lambda folder: _result("optimize", folder),
        "study": _study,
        "verify": _verification,
        "overnight": _night,
        "train": _model,
        "play": _page,
    }
    try:
        return readers[kind](path)
    except TactiluxError as error:
        return damaged(kind, path, str(error))
    except OSError as error:
        return damaged(kind, path, f"{error.filename or path} cannot be read ({error.strerror})")
    except Exception as error:  # of whatever a stranger has put there; the other runs are listed
        return damaged(kind, path, f"it cannot be read ({type(error).__name__}: {error})")


def damaged(kind: str, path: Path, why: str) -> RunRecord:
    """Return a run that is named for what is wrong with it."""
    page = path / REPORT
    report = page if page.is_file() else None
    return RunRecord(kind, path, _time(path), "damaged", report=report, note=why)


def _time(path: Path) -> float:
    return path.lstat().st_mtime


class _Strict(BaseModel):
    """A part of a record: other keys may stand beside it, numbers are finite."""

    model_config = ConfigDict(allow_inf_nan=False, strict=True)


class _Manifest(_Strict):
    """What a result folder says of its files; earlier ones do not tell their SHA-256."""

    files: list[str]
    sums: dict[str, str] = {}


class _Study(_Strict):
    """What ``explore --vary`` found."""

    scene: str
    scene_hash: str
    sentence: str


class _Estimate(_Strict):
    """Of a rendered design; earlier records do not tell degrees."""

    score: float
    interval: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    reader_error_deg: float | None = None
    normal_error_deg: float | None = None


class _Gain(_Strict):
    value: float
    interval: Annotated[list[float], Field(min_length=2, max_length=2)]


class _Verified(_Strict):
    """What ``tactilux verify`` keeps beside its renders."""

    design: _Estimate
    difference: _Gain
    converged: bool
    samples: int
    seeds: list[int]


class _Named(_Strict):
    name: str
    hash: str


class _Played(_Strict):
    """What the script of a page to play with begins with; earlier pages do not tell scores."""

    scene: _Named
    level: str
    effort: str | None = None
    half_width: Annotated[float, Field(alias="halfWidth")]
    designs: dict[str, Any]
    scores: dict[str, float] = {}


_Part = TypeVar("_Part", bound=BaseModel)


def _parsed(part: type[_Part], path: Path, content: dict[str, Any] | None = None) -> _Part:
    """Return what ``part`` tells of the sealed file ``path``, or of the ``content`` of another."""
    try:
        return part.model_validate(read_sealed(path) if content is None else content)
    except ValidationError as error:
        problem = problem_sentence(error.errors(include_url=False)[0])
        raise RunError(f"{path.name} is damaged ({problem})", field="run") from None
    except ValueError as error:
        raise RunError(f"{path.name} is damaged ({error})", field="run") from None


def _interval(ends: list[float] | None) -> tuple[float, float] | None:
    return None if ends is None else (ends[0], ends[1])


def _errors(said: object) -> dict[ReaderName, float]:
    """Return the readers' degrees among what is ``said`` of a design."""
    found = {reader: getattr(said, f"{key}_deg", None) for reader, key in ERROR_KEYS.items()}
    return {reader: value for reader, value in found.items() if value is not None}


def _of_design(file: DesignFile) -> dict[str, Any]:
    """Return what a design file says of the scene and of its score."""
    known: dict[str, Any] = {
        "scene": file.scene,
        "scene_hash": file.scene_hash,
        "lights": file.design,
    }
    if file.level is not None and file.score is not None:
        known |= {"level": file.level, "effort": file.effort}
        known |= {"score": file.score.value, "interval": file.score.interval}
        known |= {"errors": _errors(file.read)}
    return known


def _result(kind: str, folder: Path) -> RunRecord:
    """Read the folder of ``explore`` or ``optimize``, which appears complete or not at all."""
    path = folder / MANIFEST
    manifest = _parsed(_Manifest, path)
    missing = [name for name in manifest.files if not (folder / name).exists()]
    if missing:
        raise RunError(f"{', '.join(missing)} missing, which its {MANIFEST} names", field="run")
    changed = [name for name, known in manifest.sums.items()
               if sha256(read_bytes(folder / name)) != known]  # fmt: skip
    play = folder / PLAY
    return RunRecord(
        kind,
        folder,
        _time(path),
        design=folder / DESIGN,
        report=folder / REPORT,
        play=play if play.is_file() else None,
        note=f"Not as written: {', '.join(changed)}" if changed else "",
        **_of_design(load_design_file(folder / DESIGN)),
    )


def _study(folder: Path) -> RunRecord:
    """Read the folder of ``explore --vary``: the best sensor and its lights."""
    path = folder / MANIFEST
    content = _parsed(_Study, path)
    page = folder / PAGE
    known = _of_design(load_design_file(folder / DESIGN))
    return RunRecord(
        "study",
        folder,
        _time(path),
        design=folder / DESIGN,
        report=page if page.is_file() else None,
        note=content.sentence,
        **known | {"scene": content.scene, "scene_hash": content.scene_hash},
    )


def _verification(path: Path) -> RunRecord:
    """Read what ``verify`` found, and the design beside it if it is still the one."""
    content = _parsed(_Verified, path)
    folder = path.parent if path.parent.name else path.parent.resolve()
    design = folder.with_name(f"{folder.name.removesuffix('-renders')}.json")
    known: dict[str, Any] = {}
    text = "The design that was rendered lies beside it no more."
    if design.is_file():
        file = load_design_file(design)
        if design_digest(file.scene_hash, file.design) in path.name:
            known, text = _of_design(file), ""
    low, high = content.difference.interval
    gain = f"{content.difference.value:+.1f} over the baseline ({low:+.1f} to {high:+.1f})"
    if not content.converged:
        gain += ", by renders that have not converged and decide nothing"
    known |= {
        "level": REFERENCE,
        "effort": None,
        "score": content.design.score,
        "interval": _interval(content.design.interval),
        "errors": _errors(content.design),
    }
    return RunRecord(
        "verify",
        path,
        _time(path),
        design=None if text else design,
        note=f"{gain}. {text}".strip(),
        **known,
    )


def _night(run: Path) -> RunRecord:
    """Read a night, also while it works; one without its record is known by its result."""
    files = [run / NIGHT, run / LOG, run / RECORD]
    time = next((_time(path) for path in files if path.is_file()), _time(run))
    state, note, best = "finished", "", None
    if (run / RECORD).is_file():
        status = status_of(run)
        state, best = status.state, status.best
        note = f"{status.stage}, {100 * status.share:.0f} %" if status.stage else ""
        if status.eta_seconds is not None:
            note += f", {duration(status.eta_seconds)} left"
    if state != "finished":
        known: dict[str, Any] = {}
        if best is not None:
            known = {name: best[name] for name in ("level", "effort")}
            if best["objective"] == "score":
                known |= {"score": best["value"], "interval": _interval(best["interval"])}
            note += f"; best so far: {status.best_words}"
        try:
            scene = load_scene(run / SCENE)
            known |= {"scene": scene.name, "scene_hash": scene.hash}
        except SceneError:  # killed before it was kept
            pass
        return RunRecord("overnight", run, time, state, note=note, **known)
    result = OvernightResult.load(run)
    page = run / NIGHT_REPORT
    return RunRecord(
        "overnight",
        run,
        time,
        scene=result.scene.name,
        scene_hash=result.scene.hash,
        level=result.best.rating.level,
        effort=result.best.rating.effort,
        score=result.best.score,
        interval=result.best.rating.interval,
        errors=_errors(result.best.rating.read),
        design=run / DESIGNS / f"{result.winner}.json",
        lights=result.best.design,
        report=page if page.is_file() else None,
        note=result.verdict[0] if result.verdict else "",
    )


def _model(folder: Path) -> RunRecord:
    """Read a model, which says how wrong it was on designs that it had not seen."""
    checker = Checker.load(folder)
    about = checker.metadata
    held_out = about.own_errors
    note = f"Scores ± {checker.score_half_width:.2f} ({checker.coverage:.0%} of held-out designs)"
    if held_out is not None:
        note += f", color error {held_out['facet_median']:.1%}"
        note += f", Kendall's tau {held_out['kendall_tau']:.2f}"
    card = folder / CARD_FILE
    return RunRecord(
        "train",
        folder,
        _time(folder / MODEL_FILE),
        scene=about.scene,
        scene_hash=about.scene_hash,
        level=checker.level,
        effort=checker.effort,
        report=card if card.is_file() else None,
        note=f"{note}.",
    )


def _page(path: Path) -> RunRecord:
    """Read what a page to play with opens with."""
    whole = read_bytes(path)
    found, seal = PLAY_FACTS.search(whole), PAGE_SEAL.search(whole)
    if found is None:
        raise RunError(f"{path.name} is cut off: its facts have no end", field="run")
    if seal is None:
        if PAGE_SEALED.search(whole[-200:]):
            raise RunError(f"{path.name} is damaged at its end", field="run")
    elif sha256(whole[: seal.start()]).encode() != seal[1]:
        raise RunError(f"{path.name} is damaged (it is not as it was written)", field="run")
    page = _parsed(_Played, path, parse_json(found[1].decode()))
    level, effort = read_level(page.level, page.effort)
    score = page.scores.get("start")
    half = page.half_width
    return RunRecord(
        "play",
        path,
        _time(path),
        scene=page.scene.name,
        scene_hash=page.scene.hash,
        level=level,
        effort=effort,
        score=score,
        interval=None if score is None else (score - half, score + half),
        report=path,
        lights=_lights(page.designs.get("start")),
        note="" if score is not None else "Its score is on the page.",
    )


def _lights(plain: Any) -> Design | None:
    """Return a design as a page to play with keeps it: red, green and blue."""
    try:
        return Design(np.radians(plain["angles_deg"]), np.array(plain["power"], dtype=float))
    except (KeyError, TypeError, ValueError, TactiluxError):
        return None


def kind_of_result(path: Path) -> str | None:
    """Return who wrote a ``result.json``; None for those of other programs.

    A file that is no JSON is that of ``explore`` where a design lies beside it, because somebody
    has to be told of it.
    """
    try:
        content = read_sealed(path)
    except (OSError, ValueError):
        return "explore" if (path.parent / DESIGN).is_file() else None
    if "scene_hash" not in content:
        return None
    if "vary" in content:
        return "study"
    return "explore" if "optimized" in content else "optimize" if "finalists" in content else None
