"""The picture that the camera sees, by bidirectional Monte Carlo: level 2 for eyes.

Fiber and film position are primary dimensions; the estimator is that of the transport cells, so
guiding and mirror connections work here too, and independent samples are the cheapest. Colors are
superposed inside one render, since materials do not depend on the channel. Made for the coating:
the glow of the diffuser's own faces beside it converges slowly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.errors import RenderError
from render.progress import Clock, OnProgress
from render.reference.llvm import VARIANT, mitsuba
from render.scene import Scene

LANES = 16384
REPLICATES = 8


@dataclass(frozen=True)
class Picture:
    """Linear radiance ``(row, column, rgb)`` and its standard error, float64.

    Drawn with pad x to the right and the tip up, as one looks at the finger from the coating's
    side: the mirror image of what the camera's sensor records.
    """

    radiance: Array
    se: Array


def render_image(
    scene: Scene,
    phi: Array,
    power: Array,
    bend: float,
    *,
    width: int = 160,
    height: int = 240,
    samples: int = 64,
    seed: int = 1,
    indented: bool = True,
    progress: OnProgress | None = None,
) -> Picture:
    """Render a design at one bend.

    Arguments:
        scene: the sensor.
        phi: ``(fiber,)`` rad.
        power: ``(fiber, 3)`` in [0, 1].
        bend: rad.
        width: pixels per row.
        height: rows, which span the camera's vertical field of view.
        samples: per pixel.
        seed: of all random numbers.
        indented: pressed by the pyramids, or untouched.
        progress: called after every pass over all lanes.

    Raises:
        RenderError: a design without light.
    """
    lit = np.nonzero(power.max(axis=1) > 0)[0]
    if not len(lit):
        raise RenderError("power is 0 for all fibers: switch at least one on", field="power")
    mitsuba(VARIANT)
    from render.cells.cell_sampler import PictureSampler
    from render.sampling.monte_carlo import MonteCarlo

    sampler = PictureSampler(scene, phi, power, bend, indented, width, height)
    run = MonteCarlo(sampler, LANES, REPLICATES, seed)
    total = max(1, round(samples * width * height / LANES))
    clock = Clock(total, progress)
    while run.done < total:
        run.sample(1)
        clock.tick()
    images = run.estimate().reshape(REPLICATES, height, width, 3)[:, :, ::-1]
    return Picture(images.mean(axis=0), images.std(axis=0, ddof=1) / np.sqrt(REPLICATES))
