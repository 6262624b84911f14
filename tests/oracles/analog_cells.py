"""Transport cells of a flat scene by analog photons (``tests.oracles.analog_tracer``).

The coating is Lambertian: where the irradiance is ``E``, it sends the radiance ``albedo E / pi`` in
all directions into the silicone. So the cells follow from the power that arrives in small bins of
the coating and from where the rays of a facet's pixels end, which are traced backwards through the
lower face: ``T = albedo / (pi n^2) mean over rays of weight E(bin)``, in which ``n^2`` is for the
larger solid angle of the light in the air. Light that reaches the camera without the coating is
left out. Where the coating has a lobe, ``tests.oracles.skin_lobe`` has what that adds.

Positions come from the scene's numbers alone; only which pixels show a facet is asked of
``render.geometry``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from render.geometry import camera_origin, facet_masks, pixel_directions
from render.scene import Scene
from tests.oracles.analog_tracer import (
    LAMBERTIAN,
    MIRROR,
    OPEN,
    Floats,
    Lamp,
    Pad,
    trace_photons,
    trace_views,
)
from tests.oracles.skin_lobe import (
    Sights,
    sights_by_bin,
    trace_photons_to_sights,
    trace_sights,
)

PITCH = 0.1
"""Of the grid of bins on the flat coating, mm, at most."""
SUBDIVISIONS = 4
"""Of an edge of a facet into bins where beams are wide."""
NARROW, FINER = np.radians(7.0), 4
"""Beams of which light changes much across a bin, rad; bins of their pads are so much smaller.

No pixel shows the rim of a facet. With bins of a quarter of it, facets in the tail of a beam of
2.5 deg had 5 to 10 % too much light, and with ones of a sixteenth what quadrature has."""
OVERSAMPLING = 16
SIDES = ("left", "right", "base", "tip", "lower")
FILM = 0.01
"""mm of air between a face and a lamp that touches it."""


class AnalogCells(NamedTuple):
    """Transport per target in 1/(mm^2 sr) per unit power, with its standard error.

    ``T`` and ``se`` are ``(target,)``, targets ``(site, facet)`` flattened or sites of the
    untouched pad; NaN where no pixel shows the target. ``replicates (batch, target)``.
    """

    T: Floats
    se: Floats
    replicates: Floats


def analog_pad(scene: Scene, *, indented: bool) -> Pad:
    """Return the flat pad of ``scene``, pressed by the pyramids at all sites or untouched."""
    pad, layer, probe = scene.pad, scene.diffuser, scene.indenter
    margin = {edge: rim_on(scene, edge) for edge in SIDES}
    half_width, half_length = pad.width / 2, pad.length / 2
    columns, rows = int(np.ceil(pad.width / PITCH)), int(np.ceil(pad.length / PITCH))
    apex = np.zeros((0, 3))
    if indented:
        depth = probe.radius * np.cos(np.pi / probe.faces) * np.tan(probe.slope)
        apex = np.array([[x, y, pad.thickness - depth] for x, y in site_centers(scene)])
    azimuth = 2 * np.pi * np.arange(probe.faces) / probe.faces
    normal = np.stack(
        [
            np.sin(probe.slope) * np.sin(azimuth),
            np.sin(probe.slope) * np.cos(azimuth),
            np.full(probe.faces, -np.cos(probe.slope)),
        ],
        axis=-1,
    )
    return Pad(
        low=np.array([-half_width - margin["left"], -half_length - margin["base"], 0.0]),
        high=np.array([half_width + margin["right"], half_length + margin["tip"], pad.thickness]),
        half_width=half_width,
        half_length=half_length,
        index=pad.index,
        alpha=face_roughness(scene),
        paint=face_paint(scene)[0],
        reflectance=face_paint(scene)[1],
        sigma_s=layer.sigma_s if layer else 0.0,
        sigma_a=layer.sigma_a if layer else 0.0,
        g=layer.g if layer else 0.0,
        albedo=scene.coating.albedo,
        apex=apex,
        normal=normal,
        radius=probe.radius,
        subdivisions=SUBDIVISIONS * finer_for_beams(scene),
        # One pitch divides both sides nearly; the last bins are cut by the pad's border.
        pitch=max(pad.width / columns, pad.length / rows),
        columns=columns,
        rows=rows,
        specular=scene.coating.specular or 0.0,
        lobe=scene.coating.roughness or 1.0,
    )


def finer_for_beams(scene: Scene) -> int:
    """Return how many times smaller than usual bins of the coating are, for narrow beams."""
    if scene.fibers is not None:
        widths = [scene.fibers.sigma_v]
    else:
        lamps = (*(scene.rows or ()), *(scene.lamps or ()))
        # cos(theta)^n falls like a Gaussian of the variance 1 / n.
        widths = [
            lamp.profile.sigma_v or (lamp.profile.cosine_exponent or 0.1) ** -0.5 for lamp in lamps
        ]
    return FINER if min(widths) < NARROW else 1


def rim_on(scene: Scene, edge: str) -> float:
    """Return how thick the diffuser is on an edge, mm: on left, tip and right if it names none."""
    layer = scene.diffuser
    milky = layer and edge in (layer.on or ("left", "tip", "right"))
    return layer.thickness if layer and milky else 0.0


def face_roughness(scene: Scene) -> Floats:
    """Return ``(6,)`` left, right, base, tip, lower and upper as the scene's entries name them."""
    alpha = np.full(6, scene.pad.roughness)
    for entry in scene.faces or ():
        for face in entry.on:
            if entry.roughness is not None:
                alpha[SIDES.index(face)] = entry.roughness
    return alpha


def face_paint(scene: Scene) -> tuple[NDArray[np.int64], Floats]:
    """Return what lies on the six faces and what it sends back, as the scene's entries say."""
    paint, reflectance = np.full(6, OPEN), np.zeros(6)
    for entry in scene.faces or ():
        for face in entry.on:
            if entry.roughness is None:
                paint[SIDES.index(face)] = LAMBERTIAN if entry.mirror is None else MIRROR
                reflectance[SIDES.index(face)] = entry.mirror or entry.white or 0.0
    return paint, reflectance


def site_centers(scene: Scene) -> Floats:
    """Return ``(site, 2)`` mm, row by row from the base, each from -x to +x."""
    sites = scene.sites
    x = sites.centre_x + sites.spacing * (np.arange(sites.columns) - 0.5 * (sites.columns - 1))
    y = sites.centre_y + sites.spacing * (np.arange(sites.rows) - 0.5 * (sites.rows - 1))
    return np.array([[a, b] for b in y for a in x])


def analog_lamp(scene: Scene, fiber: int, phi: float) -> Lamp:
    """Return fiber ``fiber`` pointing in direction ``phi`` (rad)."""
    fibers = scene.fibers
    if fibers is None:
        return schema_2_lamp(scene, fiber, phi)
    x, y = scene.pad.width / 2, scene.pad.length / 2
    edge = "left" if fiber < fibers.left else "tip"
    edge = edge if fiber < fibers.left + fibers.tip else "right"
    beyond = fibers.gap + rim_on(scene, edge)
    if fiber < fibers.left:
        at = -y + 2 * y * (fiber + 0.5) / fibers.left
        center, along, inward = (-x - beyond, at), (0.0, 1.0), (1.0, 0.0)
    elif fiber < fibers.left + fibers.tip:
        at = -x + 2 * x * (fiber - fibers.left + 0.5) / fibers.tip
        center, along, inward = (at, y + beyond), (1.0, 0.0), (0.0, -1.0)
    else:
        at = y - 2 * y * (fiber - fibers.left - fibers.tip + 0.5) / fibers.right
        center, along, inward = (x + beyond, at), (0.0, 1.0), (-1.0, 0.0)
    level = np.cos(phi) * np.array(along) + np.sin(phi) * np.array(inward)
    beam = np.array([*(np.cos(fibers.tilt) * level), np.sin(fibers.tilt)])
    place = np.array([*center, fibers.height])
    return Lamp(place, frame_about(beam), fibers.diameter / 2, fibers.sigma_v)


def frame_about(beam: Floats) -> Floats:
    """Return axes ``(3, 3)`` in columns, the last along ``beam``."""
    across = np.cross(beam, [0.3, 0.7, 0.1])
    across /= np.linalg.norm(across)
    return np.ascontiguousarray(np.stack([across, np.cross(across, beam), beam], axis=-1))


def schema_2_lamp(scene: Scene, number: int, phi: float) -> Lamp:
    """Return lamp ``number`` of rows and lists; rows are one to an edge here.

    They are numbered around the pad, wherever they stand in the file.
    """
    x, y = scene.pad.width / 2, scene.pad.length / 2
    around = ("left", "tip", "right", "base")
    for row in sorted(scene.rows or (), key=lambda row: around.index(row.edge)):
        size = len(row.at) if row.at is not None else row.count or 0
        if number >= size:
            number -= size
            continue
        half = x if row.edge in ("tip", "base") else y
        places = row.at or tuple(half * (2 * i + 1 - size) / size for i in range(size))
        place = sorted(places)[number if row.edge in ("left", "tip") else size - 1 - number]
        gap = row.gap if row.turns or row.gap < 0.0 else max(row.gap, FILM)
        beyond = gap + rim_on(scene, row.edge)
        center = {
            "left": (-x - beyond, place), "tip": (place, y + beyond),
            "right": (x + beyond, place), "base": (place, -y - beyond),
        }[row.edge]  # fmt: skip
        inward = {"left": (1, 0), "tip": (0, -1), "right": (-1, 0), "base": (0, 1)}[row.edge]
        along = (0, 1) if row.edge in ("left", "right") else (1, 0)
        turned = phi if row.turns else np.pi / 2
        level = np.cos(turned) * np.array(along) + np.sin(turned) * np.array(inward)
        beam = np.array([*(np.cos(row.tilt) * level), np.sin(row.tilt)])
        position, lamp = np.array([*center, row.height]), row
        break
    else:
        listed = (scene.lamps or ())[number]
        beam = np.array(listed.direction) / np.linalg.norm(listed.direction)
        if listed.turns:
            # By 90 deg - phi about z, as rows turn on all edges.
            cos, sin = np.sin(phi), np.cos(phi)
            beam = np.array([cos * beam[0] - sin * beam[1], sin * beam[0] + cos * beam[1], beam[2]])
        position, lamp = np.array(listed.position), listed
        if position[2] == 0.0:
            position[2] = -FILM
    profile = lamp.profile
    return Lamp(
        position, frame_about(beam), lamp.diameter / 2, profile.sigma_v or 1.0,
        profile.cosine_exponent or 0.0,
    )  # fmt: skip


def bin_areas(pad: Pad) -> Floats:
    """Return the area of every tally bin ``(bin,)`` in mm^2."""
    sites, faces, m = len(pad.apex), len(pad.normal), pad.subdivisions
    slope_cos = -pad.normal[0, 2]
    facet = pad.radius**2 * np.sin(np.pi / faces) * np.cos(np.pi / faces) / slope_cos
    i, j = np.meshgrid(np.arange(m), np.arange(m), indexing="ij")
    # Halves lie on the edge opposite to the apex; what lies beyond it is never hit.
    part = np.where(i + j < m - 1, 2.0, np.where(i + j == m - 1, 1.0, 0.0)) / m**2
    on_facets = np.tile(facet * part.ravel(), sites * faces)
    step = pad.pitch / OVERSAMPLING
    x = (np.arange(pad.columns * OVERSAMPLING) + 0.5) * step - pad.half_width
    y = (np.arange(pad.rows * OVERSAMPLING) + 0.5) * step - pad.half_length
    flat = (y < pad.half_length)[:, None] & (x < pad.half_width)[None, :]
    for center in pad.apex:
        near_x = np.nonzero(np.abs(x - center[0]) <= pad.radius)[0]
        near_y = np.nonzero(np.abs(y - center[1]) <= pad.radius)[0]
        dx, dy = np.meshgrid(x[near_x] - center[0], y[near_y] - center[1])
        # The base polygon: within all facets' edges.
        inside = np.ones(dx.shape, dtype=bool)
        for normal in pad.normal:
            outward = normal[:2] / np.hypot(*normal[:2])
            inside &= outward[0] * dx + outward[1] * dy < pad.radius * np.cos(np.pi / faces)
        flat[np.ix_(near_y, near_x)] &= ~inside
    cut = flat.reshape(pad.rows, OVERSAMPLING, pad.columns, OVERSAMPLING)
    return np.concatenate([on_facets, pad.pitch**2 * cut.mean(axis=(1, 3)).ravel()])


def target_rays(
    scene: Scene, bend: float, indented: bool, count: int, seed: int
) -> list[Floats | None]:
    """Return, per target, ``count`` directions ``(ray, 3)`` through its pixels; None without any.

    Targets are the facets of all sites of a pressed pad, or the spots of an untouched one.
    """
    rng = np.random.Generator(np.random.PCG64(seed))
    masks, faces = facet_masks(scene, bend), scene.indenter.faces
    rays: list[Floats | None] = []
    for site in range(scene.sites.count):
        for facet in range(faces) if indented else [faces]:
            pixels = masks.of(site, facet)
            if not len(pixels):
                rays.append(None)
                continue
            pixel = rng.choice(pixels, count)
            column, row = (
                number + rng.random(count)
                for number in (pixel % masks.columns, pixel // masks.columns)
            )
            rays.append(pixel_directions(scene, masks.columns, masks.rows, column, row))
    return rays


@dataclass(frozen=True)
class AnalogScene:
    """One pad and what its camera sees of it.

    Arguments:
        scene: the sensor, at bend 0.
        indented: pressed by the pyramids at all sites, or untouched.
        views: rays per target that are traced back from the camera.
        seed: of all random numbers.
    """

    scene: Scene
    indented: bool = True
    views: int = 20_000
    seed: int = 1

    @cached_property
    def pad(self) -> Pad:
        """The pad that photons move in."""
        return analog_pad(self.scene, indented=self.indented)

    @cached_property
    def area(self) -> Floats:
        """Areas of the tally bins ``(bin,)``, mm^2."""
        return bin_areas(self.pad)

    @cached_property
    def view(self) -> Floats:
        """Mean weight with which a ray of a target sees each bin, ``(target, bin)``."""
        rays = target_rays(self.scene, 0.0, self.indented, self.views, self.seed)
        weights = np.zeros((len(rays), len(self.area)))
        for target, directions in enumerate(rays):
            if directions is None:
                weights[target] = np.nan
                continue
            target_of = np.full(self.views, target)
            trace_views(
                self.pad, camera_origin(self.scene), directions, target_of, self.seed + target,
                weights,
            )  # fmt: skip
        return weights / self.views

    @cached_property
    def sights(self) -> Sights:
        """The rays of all targets by the bin that they see."""
        found = []
        for target, directions in enumerate(
            target_rays(self.scene, 0.0, self.indented, self.views, self.seed)
        ):
            if directions is not None:
                bins, arrived, weight = trace_sights(
                    self.pad, camera_origin(self.scene), directions, self.seed + target
                )
                found.append((bins, arrived, weight, np.full(len(bins), target)))
        bins, arrived, weight, owner = (np.concatenate(part) for part in zip(*found, strict=True))
        return sights_by_bin(bins, arrived, weight / self.views, owner, len(self.area))

    def irradiance(self, fiber: int, phi: float, photons: int, batches: int) -> Floats:
        """Return the power per area ``(batch, bin)`` in 1/mm^2 that a fiber of power 1 brings."""
        lamp, bins = analog_lamp(self.scene, fiber, phi), len(self.area)
        first = (self.seed * 1009 + fiber) * 4099
        arriving = [
            trace_photons(self.pad, lamp, photons // batches, first + batch, bins)[0]
            for batch in range(batches)
        ]
        return np.array(arriving) / np.where(self.area > 0, self.area, np.inf)

    def cells(self, fiber: int, phi: float, photons: int, batches: int = 16) -> AnalogCells:
        """Return the transport of one fiber in direction ``phi`` (rad) to all targets."""
        pad = self.scene.pad
        brightness = self.scene.coating.albedo / (np.pi * pad.index**2)
        if self.scene.coating.specular:
            replicates = self._with_lobe(fiber, phi, photons, batches)
        else:
            replicates = brightness * self.irradiance(fiber, phi, photons, batches) @ self.view.T
        return AnalogCells(
            replicates.mean(axis=0),
            replicates.std(axis=0, ddof=1) / np.sqrt(batches),
            replicates,
        )

    def _with_lobe(self, fiber: int, phi: float, photons: int, batches: int) -> Floats:
        """Return the replicates ``(batch, target)`` of a skin with a lobe."""
        lamp, index = analog_lamp(self.scene, fiber, phi), self.scene.pad.index
        first = (self.seed * 1009 + fiber) * 4099
        area = np.where(self.area > 0, self.area, np.inf)
        replicates = []
        for batch in range(batches):
            power, lobe, _ = trace_photons_to_sights(
                self.pad, lamp, photons // batches, first + batch, area, self.sights,
                len(self.view),
            )  # fmt: skip
            diffuse = self.scene.coating.albedo / np.pi * self.view @ (power / area)
            replicates.append((diffuse + lobe) / index**2)
        return np.array(replicates)
