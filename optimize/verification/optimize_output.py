"""What an optimization at level 2 leaves behind: designs with rendered ratings, and its record."""

from __future__ import annotations

from pathlib import Path

from optimize.design.design import Design
from optimize.design.design_file import save_design
from optimize.design.rating import PARTS, Rating
from optimize.scoring.jackknife import JackknifeEstimate
from optimize.scoring.rank_agreement import RankAgreement
from optimize.ui.output import fresh_directory, write_manifest
from optimize.verification.optimization import Optimization
from optimize.verification.verification_loop import Round
from render.scene.schema import Scene

DESIGN, BASELINE, THESIS = "design.json", "baseline.json", "thesis.json"


def write_optimization(
    scene: Scene, found: Optimization, target: Path, result: dict[str, object]
) -> None:
    """Write designs and record into ``target``, which they replace together."""
    with fresh_directory(target) as folder:
        for name, design in zip(found.verdict.names, found.verdict.renders.designs, strict=True):
            file = {"baseline": BASELINE, "thesis": THESIS, "runner-up": "runner-up.json"}
            if name == found.winner:
                file[name] = DESIGN
            save_design(folder / file[name], design, scene, _rating(found, name))
        write_manifest(folder, result)


def optimization_to_json(scene: Scene, found: Optimization, target: Path) -> dict[str, object]:
    """Return what programs rely on; ``design`` is the path of the design that is handed over."""
    verdict = found.verdict
    result: dict[str, object] = {
        "scene": scene.name,
        "scene_hash": scene.hash,
        "level": "reference",
        "design": str(target / DESIGN),
        "finalists": {
            name: {
                "score": _estimate(verdict.of(name).score),
                "gain": None if name == "baseline" else _estimate(verdict.gain("baseline", name)),
            }
            for name in verdict.names
        },
        "final_render_seconds": verdict.renders.seconds,
        "surrogate_training_render_seconds": found.training_seconds,
        "monochrome": found.design.monochrome,
    }
    if found.loop is not None:
        result["loop"] = {
            "render_seconds": found.loop.seconds,
            "wall_seconds": found.wall["loop"],
            "renders": len(found.loop.rounds),
            "reason": found.loop.reason,
            "verdict": verdict.sentence("runner-up", "winner")
            if "runner-up" in verdict.names
            else None,
            "rounds": [_round(entry) for entry in found.loop.rounds],
        }
    if found.thesis is not None:
        result["thesis"] = {
            "render_seconds": found.thesis.seconds,
            "wall_seconds": found.wall["thesis"],
            "renders": found.thesis.runs,
            "converged": found.thesis.directions.converged,
            "believed_score": found.thesis.score,
        }
    if found.loop is not None and found.thesis is not None:
        result["difference"] = _estimate(verdict.gain("thesis", "winner"))
    return result


def _rating(found: Optimization, name: str) -> Rating:
    measured = found.verdict.of(name)
    values = {part: measured.parts[part].value for part in PARTS}
    return found.verdict.scale.rating("reference", values, measured.score.interval())


def _estimate(found: JackknifeEstimate) -> dict[str, object]:
    return {
        "value": found.value,
        "se": found.se,
        "interval": list(found.interval()),
        "noise_bias": found.plain - found.value,
    }


def _round(done: Round) -> dict[str, object]:
    gains: list[JackknifeEstimate | None] = [None, *done.gains]
    return {
        "number": done.number,
        "render_seconds": done.seconds,
        "ranking": _agreement(done.agreement),
        "ranking_after_refit": _agreement(done.refitted),
        "refit_prior": done.correction.tau,
        "designs": [
            {
                "role": entry.role,
                **_described(entry.design),
                "predicted": entry.predicted,
                "spread": entry.spread,
                "score": _estimate(measured.score),
                "gain": None if gain is None else _estimate(gain),
            }
            for entry, measured, gain in zip(done.proposals, done.measured, gains, strict=True)
        ],
    }


def _agreement(found: RankAgreement) -> dict[str, object]:
    return {"tau": found.tau, "decided": found.decided, "pairs": found.pairs}


def _described(design: Design) -> dict[str, object]:
    return {"phi": design.phi.tolist(), "power": design.power.tolist()}
