"""A whole emulated rig: its true material, powers, directions and camera, known to it alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, solve_triangular
from scipy.ndimage import map_coordinates

from hw.calibration.line_model import SurrogateCorrection
from hw.calibration.log_ratio import LogRatios, kernel, log_ratios
from hw.calibration.material import material_space
from hw.calibration.material_table import fiber_images
from hw.calibration.pad_light import PadLight, render_pad_light
from hw.calibration.reference_lines import Setup, in_frame, sample_image
from hw.camera.led_colors import own_channels
from hw.camera.projection import pad_positions, pixels_of
from hw.emulator.emulated_camera import CameraImperfections
from hw.errors import CalibrationError
from render.arrays import Array
from render.progress import OnProgress
from render.scene import Palette
from tactilux import Scene

Image = NDArray[np.float32]

RAYS = 360_000
ENOUGH_SAMPLES = 50
"""With which the figures of the emulated rig are made."""
FIRST_SEED = 900_000
"""Nothing that a fit is built from has such seeds."""


@dataclass(frozen=True, eq=False)
class TrueParameters:
    """What the rig is truly like.

    Arguments:
        material: ``(quantity,)`` of its `MaterialSpace`; None where calibration does not know
            such scenes: the optics are then the scene's.
        power: ``(fiber,)`` relative to the design's.
        turn: ``(fiber,)`` rad beside the design's directions.
        gain: counts per unit radiance.
        imperfections: of the camera.
        seed: of everything random in it.
    """

    material: Array | None
    power: Array
    turn: Array
    gain: float
    imperfections: CameraImperfections
    seed: int

    def built(self, setup: Setup) -> Setup:
        """Return what was truly built of ``setup``: its material and directions."""
        own = setup if self.material is None else setup.of(self.material)
        return replace(own, phi=np.clip(setup.phi + self.turn, 0.0, np.pi))


def random_parameters(scene: Scene, seed: int) -> TrueParameters:
    """Return a rig near ``scene``: material within 35 %, powers 8 %, directions 1 deg.

    Of a clear pad, the roughness of lit faces lies within 0.15, the albedo within 0.3. Lamps that
    cannot turn point as the scene says.
    """
    rng, palette = np.random.default_rng([seed, 77]), scene.palette.one_shot
    unit = rng.uniform(-1, 1, 4)
    material = _random_material(
        scene, np.append(unit, np.random.default_rng([seed, 79]).uniform(-1, 1))
    )
    imperfections = CameraImperfections(
        vignetting=float(rng.uniform(0.0, 0.2)),
        tilt=tuple(float(x) for x in np.radians(rng.uniform(-0.5, 0.5, 3))),  # type: ignore[arg-type]
        gain=tuple(rng.uniform(0.85, 1.0, len(palette.channels)).tolist()),
        leak=_random_leak(palette, seed),
        seen=palette.response,
    )
    fibers = scene.lamp_count
    return TrueParameters(
        material,
        np.exp(0.08 * rng.standard_normal(fibers)),
        np.radians(rng.standard_normal(fibers)) * [lamp.turns for lamp in scene.placed_lamps()],
        0.0,
        imperfections,
        seed,
    )


def _random_leak(palette: Palette, seed: int) -> tuple[tuple[float, ...], ...]:
    """Return up to 8 % of each LED color in each channel that is not its own.

    Where a channel is not one color's alone, its LEDs are also up to 15 % stronger or weaker than
    they are said to be: gains of channels do not make up for that.
    """
    response, own = palette.matrix, own_channels(palette.matrix)
    leak = np.random.default_rng([seed, 78]).uniform(0.0, 0.08, own.shape) * ~own
    shared = own & ((own.sum(axis=0) > 1) | (own.sum(axis=1, keepdims=True) > 1))
    strength = np.random.default_rng([seed, 80]).uniform(-0.15, 0.15, own.shape)
    leak = np.where(shared, response * strength, leak)
    return tuple(map(tuple, leak.tolist()))


def _random_material(scene: Scene, unit: Array) -> Array | None:
    """Return a material near that of ``scene`` by numbers in [-1, 1]; None: it is the scene's."""
    try:
        space = material_space(scene)
    except CalibrationError:
        return None
    middle, unit = space.values(space.of(scene)), unit[: len(space.quantities)]
    # Absorption may be anything small; the scene's own is an assumption.
    middle = np.maximum(middle, [0.02 if one == "absorption" else 0.0 for one in space.names])
    value = middle * np.exp(0.35 * unit)
    for number, knowledge in space.knowledge.items():
        if not knowledge.relative:
            value[number] = middle[number] + 1.5 * knowledge.known * unit[number]
    low, high = space.values(space.low), space.values(space.high)
    margin = 0.02 * (high - low)
    return space.material(np.clip(value, low + margin, high - margin))


def true_images(
    setup: Setup,
    truth: TrueParameters,
    *,
    correction: SurrogateCorrection | None = None,
    rays: int = RAYS,
) -> Image:
    """Return the rig's true radiance per unit power, ``(bend, fiber, row, column[, channel])``.

    There are channels where the skin's albedo differs by them. The random walk has a seed of the
    rig's own, so that nothing a fit was built from is in it.

    ``setup`` is what is known of the rig, ``truth`` what is not. The ``correction`` from preview to
    surrogate is applied where given.
    """
    own = truth.built(setup)
    images = by_channel(own, lambda one: fiber_images(one, rays=rays, seed=FIRST_SEED + truth.seed))
    if correction is not None:
        size = images.shape[2:4]
        for index, bend in enumerate(setup.bends):
            position = pad_positions(setup.scene, float(bend), *size).reshape(1, -1, 2)
            ratio = np.exp(correction.log_ratio(position)[index])
            images[index] *= ratio.reshape(images.shape[1:])
    return images


def by_channel(setup: Setup, images_of: Callable[[Setup], Image]) -> Image:
    """Return images of a sensor, ``images_of`` those of one albedo; the last axis is the channel.

    Where the skin has one albedo there is no such axis.
    """
    scene = setup.scene
    if not scene.by_channel:
        return images_of(setup)
    each = [images_of(replace(setup, scene=one)) for one in scene.one_albedo_scenes]
    return np.stack([each[albedo] for albedo in scene.albedo_of_channel], axis=-1)


def rendered_images(
    setup: Setup,
    truth: TrueParameters,
    lit: Sequence[Sequence[int]],
    *,
    samples: int,
    progress: OnProgress | None = None,
) -> Image:
    """Return the rig's true radiance per unit power as the reference renders it, each albedo so.

    Renders of every fiber are noisy by some per cent at each millimeter, more than a camera is; so
    pictures of the true material are drawn by the preview, with random numbers of the rig's own,
    and brought to the reference by the smooth ratio of both (`SmoothRatio`).
    Rendered is what lies around each fiber's reference lines; far from them the ratio goes back to
    a constant.

    ``setup`` is what is known of the rig, ``truth`` what is not. Fibers that are not ``lit`` at a
    bend stay dark. There are ``samples`` light paths per fiber and cell of the pad.

    Raises:
        CalibrationError: they are so few that renders of a bend say nothing.
    """
    return by_channel(
        truth.built(setup),
        lambda one: _rendered(one, FIRST_SEED + truth.seed, lit, samples, progress),
    )


def _rendered(
    setup: Setup,
    seed: int,
    lit: Sequence[Sequence[int]],
    samples: int,
    progress: OnProgress | None,
) -> Image:
    """Return what `rendered_images` does for a rig of one albedo, which ``setup`` is."""
    light = render_pad_light(
        setup, lit, samples=samples, seed=seed, around=setup.lines.on_pad, progress=progress
    )
    images = fiber_images(setup, rays=RAYS, seed=seed)
    for bend, angle in enumerate(setup.bends):
        images[bend, np.setdiff1d(np.arange(len(setup.phi)), lit[bend])] = 0.0
        if not len(lit[bend]):
            continue
        try:
            _bring_to_reference(setup.scene, images[bend], light, lit[bend], bend, float(angle))
        except CalibrationError:
            raise CalibrationError(
                f"--rig-samples = {samples} light paths per fiber and cell leave every render of "
                f"the rig at bend {np.degrees(angle):g}° too noisy to use: give more, "
                f"{ENOUGH_SAMPLES} are enough for finger20",
                field="rig_samples",
            ) from None
    return images


def _bring_to_reference(
    scene: Scene,
    images: NDArray[np.float32],
    light: PadLight,
    fibers: Sequence[int],
    bend: int,
    angle: float,
) -> None:
    """Multiply drawn images ``(fiber, row, column)`` by the smooth ratio of rendered to drawn."""
    blocks = light.positions()
    flat = blocks.reshape(-1, 2)
    pixels = pixels_of(scene, angle, flat, *images.shape[1:])
    part = light.square_of(flat, light.blocks // 2)
    places = {fiber: in_frame(scene, fiber, flat) for fiber in fibers}
    with np.errstate(divide="ignore", invalid="ignore"):
        smooth = SmoothRatio(
            [
                log_ratios(
                    places[fiber],
                    part,
                    light.radiance[bend, fiber].ravel(),
                    light.error[bend, fiber].ravel(),
                    np.log(sample_image(images[fiber], pixels)),
                )
                for fiber in fibers
            ]
        )
    found = smooth.mean([places[fiber] for fiber in fibers])
    found = found.reshape(len(fibers), *blocks.shape[:2])
    seen = np.nan_to_num(pad_positions(scene, angle, *images.shape[1:]))
    row, column = np.moveaxis((seen - blocks[0, 0])[..., ::-1] / light.block, -1, 0)
    for fiber, ratio in zip(fibers, found, strict=True):
        images[fiber] *= np.exp(map_coordinates(ratio, [row, column], order=3, mode="nearest"))


SHARED_AMPLITUDES = (0.02, 0.04, 0.08, 0.16, 0.32)
FIBER_AMPLITUDES = (0.0, 0.005, 0.01, 0.02, 0.04, 0.08)
"""Prior standard deviations of the shared and the fibers' own fields, relative; the data choose."""
CONSTANT_STD = 1.0
"""Prior standard deviation of each fiber's constant: nothing is known of it, its power takes it
up."""


class SmoothRatio:
    """Rendered light over drawn light of one material: smooth, and much alike for all fibers.

    The renders' noise is neither. So the logarithm of the ratio is a Gaussian process in the
    fiber's frame (Rasmussen and Williams 2006, eq. 2.25 and 2.26): a constant of each fiber, a
    field that all share, and one of its own for each. ``data`` has one entry per fiber.

    Raises:
        CalibrationError: no data at all.
    """

    def __init__(self, data: Sequence[LogRatios]) -> None:
        """Choose the fields' sizes by the data's marginal likelihood (eq. 2.30)."""
        self._values = np.concatenate([ratios.log_ratio for ratios in data])
        if not len(self._values):
            raise CalibrationError("no render tells anything about the ratio: render longer")
        noise = np.diag(np.concatenate([ratios.variance for ratios in data]))
        place = self._place = np.concatenate([ratios.place for ratios in data])
        self._fiber = np.repeat(np.arange(len(data)), [len(ratios.place) for ratios in data])
        near, same = kernel(place, place), self._fiber[:, None] == self._fiber
        best = -np.inf
        for shared in SHARED_AMPLITUDES:
            for own in FIBER_AMPLITUDES:
                whole = CONSTANT_STD**2 * same + near * (shared**2 + own**2 * same) + noise
                root = np.linalg.cholesky(whole)
                white = solve_triangular(root, self._values, lower=True)
                likelihood = -0.5 * float(white @ white) - float(np.log(np.diag(root)).sum())
                if likelihood > best:
                    best, self.shared, self.own, self._root = likelihood, shared, own, root

    def mean(self, wanted: Sequence[Array]) -> Array:
        """Return the log ratio at places ``(n, 2)`` of every fiber, one after the other."""
        weight, found = cho_solve((self._root, True), self._values), []
        for fiber, places in enumerate(wanted):
            same = self._fiber == fiber
            near = kernel(places, self._place) * (self.shared**2 + self.own**2 * same)
            found.append((near + CONSTANT_STD**2 * same) @ weight)
        return np.concatenate(found)
