"""Shadows around a deep indentation (thesis 6.1): the light that a bolt head keeps from the skin.

The metric presses small pyramids, which cast no shadow to speak of. Here a cylinder is pressed deep
into the unbent pad at every site, upright on the skin there. Around it, the light of a fiber is
missing where the straight line to the fiber's glow passes through the cylinder. The penalty is the
mean length of the missing color, in counts, so that it compares with S.

All light of a fiber is taken to come straight from its glow on the edge: light that arrives over
the lower face or over the skin would fill the shadows a little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optimize.design import Array, Design
from optimize.search import Objective
from render.chebyshev import differentiation_matrix, interpolation_weights
from render.errors import SceneError, TableError
from render.geometry import SkinChart, flat_fiber_poses, flat_sites, fresnel
from render.preview import point_lights
from render.preview.beams import BEAM_MARK, EMBEDDED_MARK, comes_straight, face_frames
from render.preview.bonded import with_bonded_window
from render.scene import OUTWARD, Scene
from render.transport import TransportTable

GLOW_MEAN, BEAM_PEAK = 0, 3
"""Where a light's emission holds the isotropic term of a glow and the peak intensity of a beam."""


@dataclass(frozen=True)
class PressedCylinder:
    """A bolt's head pressed into the pad, and where around it the skin is looked at; mm.

    Arguments:
        radius, depth: of the cylinder.
        distance: from its side to the points; points: evenly spaced around it.
    """

    radius: float = 3.0
    depth: float = 1.0
    distance: float = 1.0
    points: int = 16


class ShadowPenalty(Objective):
    """Mean length of the color that a bolt takes away, in counts; negated as an objective."""

    def __init__(
        self, scene: Scene, table: TransportTable, bolt: PressedCylinder | None = None
    ) -> None:
        """Multiply the untouched pad's light by what the bolt hides of it.

        Raises:
            TableError: the table has no background, or not the flat pad's.
        """
        if table.background is None or not len(table.bends) or abs(table.bends[0]) > 1e-9:
            raise TableError(
                "shadows need the background of the flat pad: use a table that has bend 0 first",
                field="background",
            )
        hidden = hidden_fraction(scene, table.phi, bolt or PressedCylinder())
        self._phi = table.phi
        fraction = np.nan_to_num(hidden)
        self._tinted = "c" if table.by_channel else ""
        light = table.exposure * table.background[:, :, 0, :, None]
        light = light * (fraction[..., None] if self._tinted else fraction)
        self._seen = np.isfinite(hidden[0, 0]).ravel()
        points = (*light.shape[:2], len(self._seen), *light.shape[4:])
        self._blocked = light.reshape(points)[:, :, self._seen]
        derivative = differentiation_matrix(table.phi)
        self._slope = np.einsum("ij,fjx...->fix...", derivative, self._blocked)

    def values(self, designs: Sequence[Design]) -> Array:
        """Return minus the penalties."""
        return np.array([self.gradient(design)[0] for design in designs])

    def gradient(self, design: Design) -> tuple[float, Array, Array]:
        """Return minus the penalty, and its derivatives by directions and by power."""
        weights = interpolation_weights(self._phi, design.phi)
        blocked = np.einsum("fj,fjx...->fx...", weights, self._blocked)
        missing = np.einsum(f"fx{self._tinted},fc->xc", blocked, design.power)
        length = np.linalg.norm(missing, axis=1)
        along = missing / np.where(length > 0.0, length, 1.0)[:, None] / len(length)
        by_phi = np.einsum("fj,fjx...->fx...", weights, self._slope)
        slope = np.einsum(f"xc,fc,fx{self._tinted}->f", along, design.power, by_phi)
        by_power = np.einsum(f"xc,fx{self._tinted}->fc", along, blocked)
        return -float(length.mean()), -slope, -by_power


def hidden_fraction(scene: Scene, phi: Array, bolt: PressedCylinder) -> Array:
    """Return the fraction of a fiber's light that a bolt at a site hides from the points around it.

    ``(fiber, phi_node, site, point)`` in [0, 1]; NaN for points beyond the pad. ``phi`` is
    ``(phi_node,)`` rad. The glow's lights weigh by their diffuse radiance, the cosines at both ends
    and the inverse square of the distance. The end points of a bare fiber send nearly the same
    towards a point, so only beside a glow the direction and the losses of a beam count.

    Raises:
        SceneError: the bolt is deeper than the pad, no point around it lies on the pad, light bends
            between it and a window, or lamps are cast into silicone with a diffuser.
    """
    if scene.window is not None and scene.window_refracts:
        raise SceneError(
            f"window.index = {scene.window.index:g}: shadows of a bolt are known along straight "
            f"light alone, allowed: pad.index = {scene.pad.index:g}; leave shadows out",
            field="window.index",
            option="--shadow",
        )
    embedded = flat_fiber_poses(scene).inside
    if scene.diffuser is not None and embedded.any():
        raise SceneError(
            f"lamp {int(embedded.argmax())} is inside the silicone: beside a diffuser the shadows "
            "of a bolt are known of lamps in the air alone, allowed: no lamp inside, or no "
            "diffuser; leave shadows out",
            field="lamps",
            option="--shadow",
        )
    scene = with_bonded_window(scene)
    thick = scene.pad.thickness
    if not 0.0 < bolt.depth < thick:
        raise SceneError(
            f"a bolt {bolt.depth:g} mm deep does not fit into the pad, allowed: below "
            f"pad.thickness = {thick:g} mm",
            field="pad.thickness",
        )
    azimuth = 2 * np.pi * np.arange(bolt.points) / bolt.points
    ring = (bolt.radius + bolt.distance) * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    # Frames of the bolts, and points of the skin straight above or below the ring around each.
    chart, uv = SkinChart(scene, 0.0), flat_sites(scene)[:, :2]
    center, frame = chart.flat(uv), chart.frames(uv)
    around = uv[:, None] + np.einsum("sij,qj->sqi", frame[:, :2, :2], ring)
    point, out = chart.flat(around), chart.frames(around)[..., 2]
    on_pad = (np.abs(around) < [scene.pad.width / 2, scene.pad.length / 2]).all(axis=-1)
    if not on_pad.any():
        raise SceneError("no point around a bolt lies on the pad: make the pad larger", field="pad")
    lights = point_lights(scene)
    position = lights.position[..., :3]
    # (node, fiber, light, n); a light is a beam for all fibers or for none.
    emission = lights.emission(np.repeat(phi[:, None], len(position), axis=1))
    marks = lights.position[..., 3].astype(int)
    beam = (marks[0] & BEAM_MARK) != 0
    strength = np.where(beam, emission[..., BEAM_PEAK], np.maximum(emission[..., GLOW_MEAN], 0.0))
    # Bolts hide what comes straight; mirror images in walls are left out.
    strength = np.where(comes_straight(marks), strength, 0.0)
    # (fiber, light, site, point), from points to lights
    spatial = position[:, :, None, None] - point
    drop = np.maximum(-(spatial * out).sum(axis=-1), 1e-6)
    square = (spatial**2).sum(axis=-1)
    face = lights.position[..., 3].astype(int) % BEAM_MARK
    inward = np.maximum((spatial * OUTWARD[face][:, :, None, None]).sum(axis=-1), 0.0)
    # A lamp in the silicone has no face before it.
    inward = np.where((marks & EMBEDDED_MARK != 0)[..., None, None], np.sqrt(square), inward)
    weight = inward * drop / square**2
    # In the bolt's frame the line p + t (light - p) is within its outline from t1 to t2, and hits
    # the bolt where it is less deep there than its end.
    begin = np.einsum("sij,sqi->sqj", frame, point - center[:, None])
    way = np.einsum("sij,flsqi->flsqj", frame, spatial)
    towards = -(way[..., :2] * begin[..., :2]).sum(axis=-1)
    flat = (way[..., :2] ** 2).sum(axis=-1)
    root = towards**2 - flat * ((begin[..., :2] ** 2).sum(axis=-1) - bolt.radius**2)
    enters = (towards - np.sqrt(np.maximum(root, 0.0))) / flat
    leaves = np.minimum((towards + np.sqrt(np.maximum(root, 0.0))) / flat, 1.0)
    highest = begin[..., 2] + np.maximum(enters * way[..., 2], leaves * way[..., 2])
    blocked = (root > 0.0) & (towards > 0.0) & (enters < 1.0) & (highest > -bolt.depth)
    glow = ~beam if scene.diffuser else slice(None)
    total = np.einsum("jfl,flsq->fjsq", strength[:, :, glow], weight[:, glow])
    hidden = np.einsum("jfl,flsq->fjsq", strength[:, :, glow], (weight * blocked)[:, glow])
    if scene.diffuser and beam.any():
        # Directions in the frames of the edges: along, into the pad, up.
        along, up = (frame[face][:, :, None, None] for frame in face_frames()[::2])
        sent_way = np.stack(
            [-(spatial * along).sum(axis=-1), inward, -(spatial * up).sum(axis=-1)], axis=-1
        )[:, beam]
        sent_way = sent_way / np.sqrt(square[:, beam])[..., None]
        straight = comes_straight(marks)[:, beam, None, None]
        milky = scene.box.layered[face][:, beam, None, None]
        sent = (
            _beam_radiance(scene, emission[:, :, beam], sent_way, milky)
            * weight[:, beam]
            * straight
        )
        total += sent.sum(axis=2).swapaxes(0, 1)
        hidden += (sent * blocked[:, beam]).sum(axis=2).swapaxes(0, 1)
    fraction = hidden / np.where(total > 0.0, total, 1.0)
    return np.asarray(np.where(on_pad, fraction, np.nan))


def _beam_radiance(scene: Scene, emission: Array, way: Array, milky: np.ndarray) -> Array:
    """Return what beams send through a thin diffuser, per cosine at the edge, for unit fibers.

    It is what the preview's shader computes (``beam_intensity`` in ``shading.glsl``): the profile
    about the beam in air, refracted into the pad, dimmed by what the diffuser scatters.

    ``emission`` is beam direction and peak intensity ``(node, fiber, light, 4 or more)``; ``way``
    are unit directions ``(fiber, light, site, point, 3)`` in the frames of the edges, and ``milky``
    says which lights shine through the diffuser.

    Returns:
        ``(node, fiber, light, site, point)`` in 1/sr.
    """
    assert scene.diffuser is not None
    layer, index, cosine = scene.diffuser, scene.pad.index, np.maximum(way[..., 1], 1e-9)
    side = index * way[..., [0, 2]]
    squared = 1.0 - (side**2).sum(axis=-1)
    height = np.sqrt(np.maximum(squared, 1e-12))
    air = np.stack([side[..., 0], height, side[..., 1]], axis=-1)
    depth = np.where(milky, (layer.sigma_s + layer.sigma_a) * layer.thickness, 0.0)
    passed = (1.0 - fresnel(cosine, 1.0 / index)[0]) * np.exp(-depth / cosine)
    # The solid angle grows by n^2 cos_pad / cos_air in air; the cosine is the caller's.
    passed = np.where((squared > 0.0) & (way[..., 1] > 0.0), passed * index**2 / height, 0.0)
    towards = np.clip(np.einsum("jfli,flsqi->jflsq", emission[..., :3], air), -1.0, 1.0)
    theta = np.arccos(towards)
    shapes = [lamp.profile.shape(theta[:, i]) for i, lamp in enumerate(scene.placed_lamps())]
    return np.asarray(emission[..., BEAM_PEAK, None, None] * np.stack(shapes, axis=1) * passed)
