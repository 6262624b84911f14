"""The picture that the camera sees, by bidirectional Monte Carlo: the reference for eyes.

Fiber and film position are primary dimensions; the estimator is that of the transport cells, so
guiding and mirror connections work here too, and independent samples are the cheapest. Colors are
superposed inside one render; channels in which the skin has other albedos are rendered one albedo
after the other. Made for the coating: the glow of the diffuser's own faces beside it converges
slowly.

A pixel alone stays noisy for long, since every sample lights one fiber. What is seen in a pixel is
known without noise, though: where the coating is, and how it is inclined. ``smoothed`` takes the
mean over pixels nearby that see a face of the same inclination (the cross bilateral filter of
Eisemann and Durand 2004), so that edges of what is pressed in stay sharp.
"""

from __future__ import annotations

import dataclasses
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.cells.choose_sampler import check_rendered
from render.errors import RenderError
from render.geometry import HeightMap, Imprint, camera_rays, in_state, refract_into_pad
from render.geometry.meshes import imprinted_coating, pad_meshes
from render.progress import Clock, OnProgress, in_stage
from render.reference.budget import TimeBudget
from render.reference.llvm import VARIANT, mitsuba
from render.scene import Scene
from render.steady_registry import steady_registry

LANES = 16384
REPLICATES = 8
SMOOTH_PIXELS, SMOOTH_NORMAL = 2.5, 0.1
"""Standard deviations of the weights of ``smoothed``: in pixels, and in length of the difference of
unit normals."""


@dataclass(frozen=True)
class Picture:
    """Linear radiance ``(row, column, channel)`` and its standard error, float64.

    ``normal`` ``(row, column, 3)`` is that of the coating in the middle of the pixel; 0 beside it.

    Drawn with pad x to the right and the tip up, as one looks at the pad from the coating's
    side: the mirror image of what the camera's sensor records.
    """

    radiance: Array
    se: Array
    normal: Array

    @property
    def coated(self) -> NDArray[np.bool_]:
        """Pixels ``(row, column)`` that see the coating."""
        return np.asarray((self.normal != 0).any(axis=-1))

    @property
    def noise(self) -> float:
        """Median relative standard error of pixels of the coating, of the sum over the colors."""
        light, error = self.radiance.sum(axis=-1), np.sqrt((self.se**2).sum(axis=-1))
        lit = self.coated & (light > 0)
        return float(np.median(error[lit] / light[lit])) if lit.any() else 0.0


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
    imprint: Imprint | HeightMap | None = None,
    budget: TimeBudget | None = None,
    progress: OnProgress | None = None,
) -> Picture:
    """Render a design at one bend.

    Arguments:
        scene: the sensor.
        phi: ``(fiber,)`` rad.
        power: ``(fiber, channel)``, what fibers give to the channels.
        bend: rad, or the number of one of the scene's states.
        width: pixels per row.
        height: rows, which span the camera's vertical field of view.
        samples: per pixel.
        seed: of all random numbers.
        indented: pressed by the pyramids, or untouched.
        imprint: what is pressed in instead of the pyramids.
        budget: the time, instead of samples.
        progress: called after every pass over all lanes.

    Raises:
        RenderError: a design without light.
    """
    if not (power > 0).any():
        raise RenderError("power is 0 for all fibers: switch at least one on", field="power")
    if scene.by_channel:
        return _albedo_by_albedo(
            scene, phi, power, bend, width=width, height=height, samples=samples, seed=seed,
            indented=indented, imprint=imprint, budget=budget, progress=progress,
        )  # fmt: skip
    if scene.states is not None and imprint is not None:
        raise RenderError(
            f"{scene.name} has states, and what is pressed in stands on the skin of one: render "
            "that (render.geometry.in_state)",
            field="imprint",
        )
    check_rendered(scene, [bend])
    scene, bend = in_state(scene, bend)
    mitsuba(VARIANT)
    from render.cells.cell_sampler import PictureSampler
    from render.sampling.monte_carlo import MonteCarlo

    pyramids = indented and imprint is None
    with steady_registry():
        sampler = PictureSampler(scene, phi, power, bend, pyramids, width, height)
    if imprint is None:
        coating = pad_meshes(scene, bend, pyramids).coating
    else:
        coating = imprinted_coating(scene, bend, imprint)
        sampler.pad = _pad_with(sampler.scene, bend, coating)
    run = MonteCarlo(sampler, LANES, REPLICATES, seed)
    total = max(1, round(samples * width * height / LANES))
    clock = Clock(total, progress)
    while run.done < total if budget is None else _another_pass(budget, run.done, clock):
        run.sample(1)
        if budget is None:
            clock.tick()
        elif progress is not None:
            progress(budget.progress())
    images = run.estimate().reshape(REPLICATES, height, width, -1)[:, :, ::-1]
    return Picture(
        images.mean(axis=0),
        images.std(axis=0, ddof=1) / np.sqrt(REPLICATES),
        _seen_normals(scene, bend, coating, width, height)[:, ::-1],
    )


def _albedo_by_albedo(
    scene: Scene,
    phi: Array,
    power: Array,
    bend: float,
    *,
    budget: TimeBudget | None,
    progress: OnProgress | None,
    **rest: Any,
) -> Picture:
    """Return the picture of a skin whose albedo depends on the channel.

    Each albedo has an equal part of the samples' work, or of the time that is left; channels that
    no lamp feeds stay dark. ``rest`` is as of `render_image`.
    """
    of_channel = np.array(scene.albedo_of_channel)
    lit = [a for a in range(len(scene.albedos)) if (power[:, of_channel == a] > 0).any()]
    found: Picture | None = None
    for number, albedo in enumerate(lit):
        seen = of_channel == albedo
        part = budget
        if budget is not None:
            seconds = budget.spent() + budget.left() / (len(lit) - number)
            part = dataclasses.replace(budget, seconds=seconds)
        told = in_stage(progress, f"albedo {number + 1} of {len(lit)}")
        one = scene.one_albedo_scenes[albedo]
        picture = render_image(one, phi, power[:, seen], bend, budget=part, progress=told, **rest)
        if found is None:
            dark = np.zeros((*picture.radiance.shape[:2], len(seen)))
            found = Picture(dark, dark.copy(), picture.normal)
        found.radiance[..., seen], found.se[..., seen] = picture.radiance, picture.se
    assert found is not None  # some lamp shines
    return found


def smoothed(picture: Picture) -> Picture:
    """Return the picture with every pixel the weighted mean of those like it.

    Weights fall with the distance in the picture and with the difference of the normals. They do
    not depend on the radiance, so that nothing is hidden because it is bright.
    """
    reach = int(np.ceil(2.5 * SMOOTH_PIXELS))
    rows, columns = picture.coated.shape
    ring = ((reach, reach), (reach, reach), (0, 0))
    inside = np.pad(np.ones((rows, columns)), ring[:2])
    normal, light, variance = (
        np.pad(part, ring) for part in (picture.normal, picture.radiance, picture.se**2)
    )
    total = np.zeros((rows, columns))
    mean, noise = np.zeros_like(picture.radiance), np.zeros_like(picture.radiance)
    for down in range(2 * reach + 1):
        for right in range(2 * reach + 1):
            part = np.s_[down : down + rows, right : right + columns]
            away = ((down - reach) ** 2 + (right - reach) ** 2) / SMOOTH_PIXELS**2
            turned = ((normal[part] - picture.normal) ** 2).sum(axis=-1) / SMOOTH_NORMAL**2
            weight = inside[part] * np.exp(-0.5 * (away + turned))
            total += weight
            mean += weight[..., None] * light[part]
            noise += weight[..., None] ** 2 * variance[part]
    whole = total[..., None]
    return Picture(mean / whole, np.sqrt(noise) / whole, picture.normal)


def _another_pass(budget: TimeBudget, done: int, clock: Clock) -> bool:
    """Say whether more of one more pass fits into the time than not."""
    return not done or budget.left() > 0.5 * clock.seconds() / done


def _pad_with(scene: Scene, bend: float, coating: Any) -> Any:
    """Return the loaded Mitsuba scene of the unlit pad with that coating."""
    import mitsuba as mi

    from render.optics.pad_scene import pad_shapes

    with tempfile.TemporaryDirectory(prefix="tactilux-") as name:
        shapes = pad_shapes(scene, bend, False, Path(name))
        path = Path(shapes["coating"]["filename"])
        path.write_bytes(coating.export(file_type="ply", vertex_normal=False))
        return mi.load_dict({"type": "scene", **shapes})


def _seen_normals(scene: Scene, bend: float, coating: Any, width: int, height: int) -> Array:
    """Return the normals ``(row, column, 3)`` where the middles of pixels meet the coating."""
    import mitsuba as mi

    rays = refract_into_pad(scene, bend, *camera_rays(scene, width, height))
    entry, direction = rays.entry.reshape(-1, 3), rays.direction.reshape(-1, 3)
    with tempfile.TemporaryDirectory(prefix="tactilux-") as name:
        path = Path(name) / "coating.ply"
        path.write_bytes(coating.export(file_type="ply", vertex_normal=False))
        shape = {"type": "ply", "filename": str(path), "face_normals": True}
        alone = mi.load_dict({"type": "scene", "coating": shape})
    met = alone.ray_intersect_preliminary(
        mi.Ray3f(
            mi.Point3f(entry.T.astype(np.float32)), mi.Vector3f(direction.T.astype(np.float32))
        )
    )
    found = np.array(met.is_valid()) & rays.inside.ravel()
    normal = np.where(found[:, None], coating.face_normals[np.array(met.prim_index) * found], 0.0)
    return np.asarray(normal.reshape(height, width, 3))
