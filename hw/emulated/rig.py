"""A whole emulated rig with a secret: its true material, powers, directions and camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hw.calibration.material import HIGH, LOW, Material
from hw.correction import Correction
from hw.emulated.board import EmulatedBoard
from hw.emulated.camera import EmulatedCamera, Flaws
from hw.fiber_images import fiber_images
from hw.pad_light import render_pad_light
from hw.projection import pad_positions
from render.bending import Array
from render.progress import Progress
from render.scene import Scene

COLUMNS, ROWS = 120, 200
RAYS = 360_000


@dataclass(frozen=True, eq=False)
class Secret:
    """What the rig is truly like.

    Arguments:
        material: of its diffuser, fibers and faces.
        power: ``(fiber,)`` relative to the design's.
        turn: ``(fiber,)`` rad beside the design's directions.
        gain: counts per unit radiance.
        flaws: of the camera.
        seed: of everything random in it.
    """

    material: Material
    power: Array
    turn: Array
    gain: float
    flaws: Flaws
    seed: int


def random_secret(scene: Scene, seed: int, *, spread: float = 0.35) -> Secret:
    """Return a rig near ``scene``: material within ``spread`` (relative), 8 % power, 1 deg turn."""
    rng = np.random.default_rng([seed, 77])
    middle = Material.of(scene).array()
    # Absorption may be anything small; the scene's own is an assumption.
    middle[1] = max(middle[1], 0.02)
    factor = np.exp(spread * rng.uniform(-1, 1, 4))
    material = np.clip(middle * factor, LOW + 0.02 * (HIGH - LOW), HIGH - 0.02 * (HIGH - LOW))
    flaws = Flaws(
        vignetting=float(rng.uniform(0.0, 0.2)),
        tilt=tuple(float(x) for x in np.radians(rng.uniform(-0.5, 0.5, 3))),  # type: ignore[arg-type]
        gain=tuple(float(x) for x in rng.uniform(0.85, 1.0, 3)),  # type: ignore[arg-type]
    )
    fibers = scene.fibers.count
    return Secret(
        Material.from_array(material),
        np.exp(0.08 * rng.standard_normal(fibers)),
        np.radians(rng.standard_normal(fibers)),
        0.0,
        flaws,
        seed,
    )


def exposed(secret: Secret, images: NDArray[np.float32], power: Array, counts: float) -> Secret:
    """Return the rig with the exposure that puts its brightest light at ``counts``.

    Arguments:
        secret: the rig.
        images: ``(fiber, row, column)`` radiance per unit power.
        power: ``(fiber, 3)`` of the light that is exposed for, in [0, 1].
        counts: of the brightest light.
    """
    light = np.einsum("fyx,fc->cyx", images, power * secret.power[:, None])
    light = light * np.array(secret.flaws.gain)[:, None, None]
    return replace(secret, gain=counts / float(np.percentile(light, 99.9)))


def true_images(
    scene: Scene,
    secret: Secret,
    phi: Array,
    bends: Array,
    *,
    correction: Correction | None = None,
    rays: int = RAYS,
) -> NDArray[np.float32]:
    """Return the rig's true radiance per unit power, ``(bend, fiber, row, column)``.

    The random walk has a seed of the rig's own, so that nothing a fit was built from is in it.

    Arguments:
        scene: what is known about the rig.
        secret: what is not.
        phi: ``(fiber,)`` rad, as designed.
        bends: ``(bend,)`` rad.
        correction: from preview to surrogate, applied where given.
        rays: light paths of the random walk.
    """
    own = secret.material.put_into(scene)
    turned = np.clip(phi + secret.turn, 0.0, np.pi)
    seed = 900_000 + secret.seed
    images = fiber_images(own, turned, bends, columns=COLUMNS, rows=ROWS, rays=rays, seed=seed)
    if correction is not None:
        for index, bend in enumerate(bends):
            position = pad_positions(scene, float(bend), ROWS, COLUMNS)
            for fiber in range(len(phi)):
                images[index, fiber] *= np.exp(correction.log_ratio(index, fiber, position))
    return images


def rendered_images(
    scene: Scene,
    secret: Secret,
    phi: Array,
    bends: Array,
    lit: Sequence[Sequence[int]],
    *,
    samples: int,
    progress: Callable[[Progress], None] | None = None,
) -> NDArray[np.float32]:
    """Return the rig's true radiance per unit power as the reference renders it.

    Slower than `true_images`, and independent of everything that a fit is built from.

    Arguments:
        scene: what is known about the rig.
        secret: what is not.
        phi: ``(fiber,)`` rad, as designed.
        bends: ``(bend,)`` rad.
        lit: fibers that will be photographed at each bend; the others stay dark.
        samples: light paths per fiber and cell of the pad.
        progress: called every few seconds.
    """
    own = secret.material.put_into(scene)
    turned = np.clip(phi + secret.turn, 0.0, np.pi)
    seed = 900_000 + secret.seed
    light = render_pad_light(own, turned, bends, lit, samples=samples, seed=seed, progress=progress)
    light = light.filled()
    images = np.zeros((len(bends), len(phi), ROWS, COLUMNS), dtype=np.float32)
    for bend, angle in enumerate(bends):
        position = pad_positions(scene, float(angle), ROWS, COLUMNS)
        for fiber in lit[bend]:
            images[bend, fiber] = np.nan_to_num(light.at(bend, fiber, position)[0])
    return images


def camera_of(
    scene: Scene, secret: Secret, images: NDArray[np.float32], board: EmulatedBoard
) -> EmulatedCamera:
    """Return the rig's camera at one bend, for ``images`` ``(fiber, row, column)``."""
    return EmulatedCamera(
        scene, images, board, secret.gain, secret.power, secret.flaws, secret.seed
    )
