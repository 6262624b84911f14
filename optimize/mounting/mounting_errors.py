"""What rounding and the usual errors of a workshop cost a design, in counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from optimize.design import Design, limits_of
from optimize.robust import material_slopes, sensitivities
from optimize.scoring import TableScorer, predict_design, search_table
from render.chebyshev import chebyshev_nodes
from render.progress import OnProgress
from render.scene import Scene, Spread
from surrogate.runtime import Checker

USUAL = {
    "fiber_angle": ("5° of every fiber's angle", Spread("normal", np.radians(5.0), "usual")),
    "led_power": ("5 % of every LED's power", Spread("normal", 0.05, "usual")),
    "camera_gain": ("2 % of the camera's gain", Spread("normal", 0.02, "usual")),
}
"""Standard deviations of errors that need no other material."""
LAYER = {"diffuser_thickness": ("0.06 mm of the diffuser", Spread("normal", 0.06, "usual"))}
LAYER_NODES = 13
"""Directions of a table with slopes by the material; enough for tenths of a count."""


@dataclass(frozen=True)
class ErrorCost:
    """What an error of a standard deviation named by ``what`` takes from S, in counts.

    ``mean`` is lost on average, ``low`` is exceeded by one sensor in ten.
    """

    what: str
    mean: float
    low: float


def surrogate_score(checker: Checker, scene: Scene) -> Callable[[Design], float]:
    """Return what rates designs on the surrogate, for `optimize.mounting.mount`."""
    bends = np.array(scene.bending.angles)
    return lambda design: float(predict_design(checker, design, bends)["score"])


def mounting_error_costs(
    checker: Checker,
    scene: Scene,
    design: Design,
    *,
    layer: bool = False,
    progress: OnProgress | None = None,
) -> list[ErrorCost]:
    """Return what the `USUAL` errors cost ``design``, the dearest first.

    Arguments:
        checker: the surrogate.
        scene: the sensor.
        design: the design.
        layer: ask also for the thickness of the diffuser, where there is one: two previews.
        progress: told of them.
    """
    usual, slopes = dict(USUAL), {}
    if layer and scene.diffuser is not None:
        usual |= LAYER
        nodes = chebyshev_nodes(LAYER_NODES, 0.0, np.pi)
        slopes = material_slopes(scene, usual, nodes, progress)
    table = checker.transport_table(nodes) if slopes else search_table(checker)
    scorer = TableScorer(table, limits=limits_of(scene))
    spreads = {name: spread for name, (_, spread) in usual.items()}
    found = sensitivities(scorer, design, spreads, slopes)
    return [ErrorCost(usual[e.name][0], e.mean_loss, e.low_loss) for e in found]
