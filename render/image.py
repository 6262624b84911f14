"""The picture that the camera sees, by PSSMLT: level 2 for eyes.

Fiber and film position are primary dimensions; the estimator is that of the transport cells, so
guiding and bridges work here too. Colours are superposed inside one render, since materials do
not depend on the channel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from render.bending import Array
from render.errors import RenderError
from render.llvm import VARIANT, mitsuba
from render.progress import Clock, Progress
from render.scene import Scene

CHAINS = 16384
CHUNK = 8
REPLICATES = 4


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
    progress: Callable[[Progress], None] | None = None,
) -> Picture:
    """Render a design at one bend.

    Arguments:
        scene: the sensor.
        phi: ``(fiber,)`` rad.
        power: ``(fiber, 3)`` in [0, 1].
        bend: rad.
        width: pixels per row.
        height: rows, which span the camera's vertical field of view.
        samples: mutations per pixel.
        seed: of all random numbers.
        indented: pressed by the pyramids, or untouched.
        progress: called after every few mutations of all chains.

    Raises:
        RenderError: a design without light.
    """
    lit = np.nonzero(power.max(axis=1) > 0)[0]
    if not len(lit):
        raise RenderError("power is 0 for all fibers: switch at least one on", field="power")
    mitsuba(VARIANT)
    from render.metropolis import Chains, Settings
    from render.picture_problem import PictureProblem

    problem = PictureProblem(scene, phi, power, bend, indented, width, height)
    chains = min(CHAINS, 1 << int(np.log2(max(1024, width * height))))
    run = Chains(
        problem,
        Settings(chains, max(8 * chains, samples * width * height // 8), 0.5, REPLICATES, seed),
    )
    pilot = run.pilot().sum(axis=1)
    # Dark pixels are lifted, so that the error is even over the picture.
    level = np.maximum(_smooth(pilot.reshape(height, width)), 0.02 * pilot.mean()).ravel()
    if not pilot.mean() > 0:
        raise RenderError("no light reaches the camera in the pilot render", field="power")
    run.bootstrap(np.repeat(1.0 / level[:, None], 3, axis=1) / len(level))
    total = CHUNK * max(1, round(samples * width * height / chains / CHUNK))
    clock = Clock(total, progress)
    while run.done < total:
        run.mutate(CHUNK)
        clock.tick(CHUNK)
    images = run.estimate().reshape(REPLICATES, height, width, 3)[:, :, ::-1]
    return Picture(images.mean(axis=0), images.std(axis=0, ddof=1) / np.sqrt(REPLICATES))


def _smooth(image: Array) -> Array:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(image, 3.0, mode="nearest"))
