"""What a placement search changed, in a sentence: which lamps, how far, and what readers gain."""

from __future__ import annotations

import numpy as np

from optimize.design import DARK, Design, baseline_design
from optimize.exploration import Exploration
from optimize.objectives import ObjectiveName
from optimize.placement.refined_places import RefinedPlaces
from optimize.ui.console import counted
from render.scene import Scene


def moved_sentence(found: Exploration) -> str:
    """Return how many lamps sit elsewhere than the baseline's, and both readers' degrees."""
    first, last = found.stages[0], found.stages[-1]
    proof = f" {found.proof}" if found.proof else ""
    return (
        f"{moved_lamps(found.scene, last.design)}: sensor reader {first.reader_error:.2f}° to "
        f"{last.reader_error:.2f}° ({last.reader_error / first.reader_error - 1:+.0%}), place "
        f"reader {first.normal_error:.2f}° to {last.normal_error:.2f}° "
        f"({last.normal_error / first.normal_error - 1:+.0%}).{proof}"
    )


def refined_sentence(found: RefinedPlaces, objective: ObjectiveName) -> str:
    """Return how far refined places were moved, and what the preview says that this gains."""
    what, unit = ("S", "") if objective == "score" else (f"{objective} reader", "°")
    moved = [distance for distance in found.moved if distance > 0.0]
    far = f" by up to {max(moved):.1f} mm" if moved else ""
    return (
        f"Places refined{far}: {what} {found.before:.2f}{unit} to {found.after:.2f}{unit} on the "
        f"preview ({found.after / found.before - 1:+.1%})"
    )


def reads_worse(second: Exploration, first: Exploration) -> bool:
    """Return whether what one search found is worse by its objective than what another did."""
    stages = second.stages[-1], first.stages[-1]
    if second.objective == "score":
        return stages[0].rating.score < stages[1].rating.score
    return stages[0].error(second.objective) > stages[1].error(second.objective)


def moved_lamps(scene: Scene, design: Design) -> str:
    """Return how many of a design's lamps sit where the baseline lights none.

    >>> from optimize.design import baseline_design
    >>> from render.scene import load_scene
    >>> moved_lamps(load_scene("digit"), baseline_design("digit"))
    '3 lamps, none at a new place'
    """
    before, after = _lit(baseline_design(scene)), _lit(design)
    lit, new = len(after), len(after - before)
    if not new:
        return f"{counted(lit, 'lamp')}, none at a new place"
    if new < lit:
        return f"{new} of {counted(lit, 'lamp')} at new places"
    return f"{counted(lit, 'lamp')}, {'at a new place' if lit == 1 else 'all at new places'}"


def _lit(design: Design) -> set[int]:
    return set(np.flatnonzero(design.colors != DARK).tolist())
