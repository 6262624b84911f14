"""What a placement search changed, in a sentence: how many lamps, and what readers gain."""

from __future__ import annotations

import numpy as np

from optimize.design import DARK, Design, baseline_design
from optimize.exploration import Exploration
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
