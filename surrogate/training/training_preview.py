"""The preview that a model is trained on: drawn, and where time allows converged."""

from __future__ import annotations

import time
from dataclasses import astuple, dataclass

import numpy as np

from render.finished_parts import FinishedParts
from render.preview.converged import ConvergedTransport, is_kept, refinements
from render.progress import OnProgress, Progress
from render.scene import Scene
from surrogate.model.converged_grid import corrected
from surrogate.model.materials import MaterialRange
from surrogate.model.preview_grid import InterpolationError, PreviewGrid

MAX_FRACTION = 0.75
"""Part of the time that following light may take from renders and fit. It is worth more: what
minutes of renders know of a color is noisier than traced light."""
NOISE_GOAL = 0.01
"""Photon noise of a color below which time is better spent on renders."""
TRIAL_SECONDS = 3.0
"""Of following light, until its estimate is believed."""


@dataclass(frozen=True)
class TrainingPreview:
    """The preview of a model.

    Arguments:
        grid: at its nodes.
        error: of the interpolation between them.
        left_out: error at materials that it was not drawn for, where the scene leaves it free.
        converged: whether light was followed to every facet, or as the shader draws it.
        half_width: of the interval of its scores, counts (`surrogate.preview_interval`); None where
            the scene leaves its material free.
        gave_up: minutes of the training in which following light would have taken too long; 0
            where that is not known.
    """

    grid: PreviewGrid
    error: InterpolationError
    left_out: InterpolationError | None
    converged: bool = False
    half_width: float | None = None
    gave_up: float = 0.0

    def may_converge(self, scene: Scene, minutes: float) -> bool:
        """Return whether light should be followed, in a training of ``minutes``.

        The same minutes give up again, so that a training that goes on ends bit-equal; but where
        all light of ``scene`` was followed meanwhile, it costs nothing.
        """
        return not self.converged and (minutes > self.gave_up or is_kept(scene))

    def save(self, parts: FinishedParts) -> None:
        """Keep it in ``parts``."""
        named = {
            "log_transport": self.grid.log_transport,
            "phi": self.grid.phi,
            "bends": self.grid.bends,
            "floored": np.array(self.grid.floored),
            "error": np.array(astuple(self.error)),
            "converged": np.array(self.converged),
            "gave_up": np.array(self.gave_up),
        }
        if self.grid.photon_noise is not None:
            named["photon_noise"] = np.array(self.grid.photon_noise)
        if self.grid.slopes is not None and self.left_out is not None:
            named |= {"slopes": self.grid.slopes, "left_out": np.array(astuple(self.left_out))}
        if self.half_width is not None:
            named["half_width"] = np.array(self.half_width)
        parts.save("preview", named)

    @classmethod
    def load(cls, parts: FinishedParts, free: MaterialRange | None) -> TrainingPreview | None:
        """Return what ``parts`` keep of a scene that leaves ``free``, or None."""
        kept = parts.load("preview")
        if kept is None:
            return None
        left_out, half_width = kept.get("left_out"), kept.get("half_width")
        noise = kept.get("photon_noise")
        return cls(
            PreviewGrid(
                kept["log_transport"],
                kept["phi"],
                kept["bends"],
                int(kept["floored"]),
                kept.get("slopes"),
                free,
                None if noise is None else float(noise),
            ),
            InterpolationError(*kept["error"]),
            None if left_out is None else InterpolationError(*left_out),
            bool(kept["converged"]),
            None if half_width is None else float(half_width),
            float(kept.get("gave_up", 0.0)),
        )


class TooLongError(Exception):
    """Light cannot be followed in the time that is there."""


def followed_grid(
    grid: PreviewGrid, scene: Scene, within: float | None, progress: OnProgress | None
) -> PreviewGrid:
    """Return the grid that traced light corrects, or ``grid`` itself where that takes too long.

    Time that is left then goes to light paths as well, until their photon noise is `NOISE_GOAL`.

    Arguments:
        grid: as the shader draws it.
        scene: the sensor.
        within: seconds of everything, of which this may take MAX_FRACTION; None for all it needs.
        progress: is told of the paths, and of why there are none.
    """
    report = progress or (lambda _: None)
    began = time.monotonic()
    found: list[ConvergedTransport] = []
    lit, latest = (began, 0.0), np.inf

    def told(at: Progress) -> None:
        nonlocal lit, latest
        now = time.monotonic()
        if at.done < latest:
            # A run has begun: what is compiled before its first light is no measure of the rest.
            lit = now, at.done
        elif within is not None and lit[1] < at.done < at.total:
            spent = now - lit[0]
            needed = now - began + spent * (at.total - at.done) / (at.done - lit[1])
            tried = spent > min(TRIAL_SECONDS, 0.1 * within)
            if needed > MAX_FRACTION * within and tried:
                raise TooLongError(f"{needed:.0f} s")
        latest = at.done
        report(at)

    try:
        for transport in refinements(scene, NOISE_GOAL, told):
            found.append(transport)
            if within is None:
                break
    except TooLongError as error:
        if not found:
            note = (
                f"Following light to every facet would take {error} of {within:.0f} s: the preview "
                "stays as the shader draws it. With more minutes, or after `tactilux explore`, it "
                "is converged."
            )
            report(Progress(1, 1, note=note))
            return grid
    if len(found) > 1:
        first, last = (float(np.max(each.noise)) for each in (found[0], found[-1]))
        note = (
            f"Light was followed again at the noisiest bends ({len(found) - 1} x): photon noise of "
            f"{last:.1%} of a color, {first:.1%} before."
        )
        report(Progress(1, 1, note=note))
    return corrected(grid, scene, found[-1])
