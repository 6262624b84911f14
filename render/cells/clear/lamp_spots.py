"""Where lamps light the skin: light subpaths on a flat pad of smooth faces, one vertex each.

A narrow beam lights a spot of the skin, and most facets see that spot alone, in the lower face and
the walls. Camera subpaths meet it rarely; light subpaths end in it. So a light subpath goes from
the lamp through the faces to the first diffuse vertex, the *spot*, and every diffuse vertex of the
camera subpaths is connected to it: over one of its images in the box that the pad is, drawn in
proportion to what it would send if nothing were in the way (virtual point lights, Keller 1997).
Camera subpaths that come to the same point find the same light, so the balance heuristic weighs
both (Veach 1997, sec. 9.2).

With p the densities per area and solid angle at the spot, a the camera's vertex, S the sum of the
geometry terms of all images times the chance of their reflections, s the chances to survive, E the
density of emission per area and solid angle in the air and n the index, the light subpath is

    kappa E = p(light) / p(camera subpath meets the lamp) = (n pi)^2 E / (s_a s_spot S)

times as likely as the camera subpath that goes on by the cosine twice.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.cells.clear.bond_optics import reflected_by_walls, way_through_bond
from render.cells.clear.lamp_ways import BEHIND, LampWays
from render.cells.clear.pad_surfaces import (
    BOND_MET,
    BOND_PASSED,
    DIELECTRIC,
    DIFFUSE,
    FROM_WINDOW,
    LOWER_MET,
    NO_TURN,
    PadSurfaces,
    step_off,
)
from render.cells.clear.unfolded_cells import CELL_MAX, box_image, side_of, wall_reflections
from render.cells.fiber_light import FiberLight
from render.sampling.reservoirs import OneNumberReservoir
from render.sampling.streams import Stream
from render.scene import Scene

REFLECTIONS = 30
"""Faces that may reflect between the lamp and the spot, as behind a diffuse vertex."""
EVENTS = 2 + REFLECTIONS
"""Events by which light subpaths are apart."""
SURVIVAL_MIN, SURVIVAL_MAX = 0.2, 0.95
"""Of Russian roulette, behind the facet: the reflectance between these."""
SLACK = 1e-2
"""mm above a spot from which it is not hidden: rays step off the faces that reflect them."""
AT_BOND = 1
"""Level of the image that a bond shows."""
BETWEEN_SPOTS = (
    0, 2 * BOND_PASSED + LOWER_MET, BOND_MET, BOND_PASSED, BOND_PASSED + LOWER_MET, FROM_WINDOW,
    FROM_WINDOW + LOWER_MET, FROM_WINDOW + BOND_MET, FROM_WINDOW + BOND_PASSED,
    FROM_WINDOW + BOND_PASSED + LOWER_MET,
)  # fmt: skip
"""Counts along z of ways between two vertices over images, from the pad and from the window."""
NEAREST = 1e-6
"""mm^2 that squared distances are at least."""


@dataclass
class Spots:
    """Ends of light subpaths (a Dr.Jit PyTree).

    ``p`` and unit ``n`` of the surface; ``sent`` is what they send per direction node, as radiance
    per geometry term, and ``others`` what the other ways to find them are worth, over s_a S.
    """

    p: mi.Point3f
    n: mi.Normal3f
    sent: list[mi.Float]
    others: mi.Float


@dataclass
class SpotConnection:
    """A camera vertex connected to one image of a spot (a Dr.Jit PyTree).

    ``direction`` leads to the image, which nothing may hide within ``clear`` mm; ``turn`` is where
    a bond reflects the line (`PadSurfaces.blocked`), and ``metal`` what mirrors on the way leave of
    the light.
    """

    direction: mi.Vector3f
    clear: mi.Float
    turn: mi.UInt32
    metal: mi.Float


class LampSpots:
    """Light subpaths of all lamps, and their connections over images."""

    def __init__(
        self, scene: Scene, surfaces: PadSurfaces, light: FiberLight, ways: LampWays, strata: int,
        paths: int,
    ) -> None:  # fmt: skip
        """List the images of a point; ``strata`` of the ``paths`` of a lane divide the nodes."""
        self.surfaces, self.light, self.ways = surfaces, light, ways
        self.strata, self.paths = strata, paths
        self.index, self.lamps = scene.pad.index, scene.lamp_count
        # The lower face reflects in turn with the top of a clear rim, and last.
        self.deepest = 5 if scene.box.layered.any() else 1
        self._images(scene)

    def _images(self, scene: Scene) -> None:
        """Upload signs, shifts, counts of reflections in clear faces and the mirrors' part."""
        metal = np.full(6, np.nan)
        for face, finish in enumerate(scene.finishes):
            at = side_of(face)
            metal[at] = finish.metal if finish.metal is not None else metal[at]
            if finish.smooth:
                metal[at] = -1.0
        rows = []
        span = range(-CELL_MAX, CELL_MAX + 1)
        if self.deepest > 1:
            metal[5] = -1.0
        levels = list(range(-self.deepest, 1))
        if self.surfaces.bond is not None:
            levels.append(AT_BOND)
        for *across, level in itertools.product(span, span, levels):
            cell = (across[0], across[1], min(level, 0))
            counts = wall_reflections(cell)
            if np.isnan(metal[counts > 0]).any():
                continue
            # Over a bond each wall is looked at by itself.
            by_walls = np.where(metal < 0, counts, 0)
            if self.surfaces.bond is not None:
                by_walls[:4] = counts[:4]
            clear = by_walls.reshape(3, 2).sum(axis=1)
            mirrored = float(np.prod(np.where(metal >= 0, metal, 1.0) ** counts))
            sign, shift = box_image(scene.box.low, scene.box.high, cell)
            if level == AT_BOND:
                sign[2] = -1.0
            rows.append([*sign, *shift, *clear, mirrored])
        self.count = len(rows)
        self.rows = mi.Float(np.array(rows, dtype=np.float32).ravel())
        dr.make_opaque(self.rows)

    @dr.syntax
    def trace(self, stream: Stream, lanes: int) -> Spots:
        """Return the spots of ``paths`` light subpaths of every lamp and lane, lanes innermost."""
        index = dr.arange(mi.UInt32, self.lamps * self.paths * lanes)
        number = index // lanes
        lamp = number // self.paths
        stratum = number % self.strata
        numbers = stream.of_lanes(index - number * lanes)
        first = number * EVENTS
        pick, u, v, _ = numbers.event(first)
        x, y, enters, _ = numbers.event(first + 1)
        node = (mi.Float(stratum) + pick) / self.strata
        o, d = self.light.sample(lamp, node, (u, v), mi.Point2f(x, y))
        # Lamps may touch the face.
        entry = self.surfaces.hit(o - 2.0 * BEHIND * d, d, dr.full(mi.Bool, True, dr.width(lamp)))
        outside = -entry.cosine
        eta = self.surfaces.index_at(entry.p, self.index)
        fresnel, _, _, _ = mi.fresnel(outside, eta)
        active = entry.valid & (entry.kind == DIELECTRIC) & (outside > 0) & (enters >= fresnel)
        inside = dr.sqrt(1.0 - (1.0 - dr.square(outside)) / eta**2)
        # --------------------------- Configure loop state ----------------------------
        onward = mi.Vector3f(d / eta + (outside / eta - inside) * entry.n)
        onward = dr.normalize(onward)
        entered = mi.Vector3f(onward)
        begin = step_off(entry.p, -entry.n)
        before, below = mi.Float(0), mi.Float(0)
        chance, metal = 1.0 - fresnel, mi.Float(1)
        counts = mi.Vector3u(0)
        reflections = mi.UInt32(0)
        spot, n = dr.zeros(mi.Point3f, dr.width(lamp)), dr.zeros(mi.Normal3f, dr.width(lamp))
        reflectance, cosine = mi.Float(0), mi.Float(0)
        while active:
            hit = self.surfaces.hit(begin, onward, active)
            active = active & hit.valid
            run = dr.select(active, dr.norm(hit.p - begin), 0.0)
            in_window = self.surfaces.in_window(begin, hit.p)
            before += dr.select(in_window, 0.0, run)
            below += dr.select(in_window, run, 0.0)
            arrived = active & (hit.kind == DIFFUSE)
            # Behind paint and skin it is dark.
            lit = arrived & (hit.cosine < 0)
            spot = dr.select(lit, step_off(hit.p, hit.n), spot)
            n = dr.select(lit, hit.n, n)
            cosine = dr.select(lit, -hit.cosine, cosine)
            reflectance = dr.select(lit, hit.reflectance, reflectance)
            active = active & ~arrived
            boundary = hit.kind == DIELECTRIC
            at = self.surfaces.index_at(hit.p, self.index)
            reflected, _, _, _ = mi.fresnel(dr.abs(hit.cosine), 1.0 / at)
            draw = numbers.event(first + 2 + reflections)[0]
            further = self.surfaces.inside(hit, onward, draw)
            chance *= dr.select(active, dr.select(boundary, reflected, further.chance), 1.0)
            metal *= dr.select(active & ~boundary, hit.reflectance, 1.0)
            active = active & (~boundary | (draw < reflected))
            for i in range(3):
                counts[i] += dr.select(active, further.counts[i], 0)
            begin = dr.select(active, further.p, begin)
            onward = dr.select(active, further.d, onward)
            reflections += 1
            active = active & (reflections < REFLECTIONS)
        # --------------------------- What the spot sends -----------------------------
        counts.z += self.surfaces.begin(spot)
        line = self.ways.leaving(
            spot, entry.p, entry.n, -entered, -d, before, below, inside, outside
        )
        carried = self.ways.along(lamp, line)
        up = mi.Vector3u(*(dr.select(onward[i] < 0, mi.UInt32(1), 0) for i in range(3)))
        way = self.ways.entry(lamp, self.ways.code(counts, up, entry.n))
        joined = carried.joined * self.ways.draws.probability(way, mi.Bool(False))
        known = (cosine > 0) & (reflectance > 0) & (carried.emitted > 0)
        emitted = dr.select(known, carried.emitted, 1.0)
        cosine = dr.select(known, cosine, 1.0)
        per_index = 1.0 / (dr.pi * self.index**2 * self._square_of_window(spot))
        sent = [
            dr.select(known, per_index * reflectance * metal * value / emitted, 0.0)
            for value in carried.radiance
        ]
        by_camera = survival_of(reflectance) / dr.pi + joined / (cosine * chance)
        return Spots(spot, n, sent, dr.select(known, per_index * by_camera / emitted, 0.0))

    def likelihood(
        self, a: mi.Point3f, n: mi.Normal3f, survival: mi.Float, spot: mi.Point3f,
        spot_n: mi.Normal3f, spot_survival: mi.Float, known: mi.Bool,
    ) -> mi.Float:  # fmt: skip
        """Return kappa of camera subpaths that went from ``a`` to ``spot``.

        0 where not ``known``: over no image, or the spot is what the camera sees.
        """
        _, total = self.connect(a, n, spot, spot_n, mi.Float(0.5), known)
        kappa = (self.index * dr.pi) ** 2 / (survival * spot_survival * total)
        kappa *= self._square_of_window(spot)
        return dr.select(known & (total > 0), kappa, 0.0)

    def known(self, counts: mi.Vector3u, up: mi.Vector3u) -> mi.Bool:
        """Return whether a chain of reflections between diffuse vertices is one of the images."""
        inside = (counts.x <= CELL_MAX) & (counts.y <= CELL_MAX)
        if self.surfaces.bond is not None:
            of_images = mi.Bool(False)
            for between in BETWEEN_SPOTS:
                of_images |= counts.z == between
            return inside & of_images
        return inside & (counts.z <= self.deepest) & ((counts.z == 0) | (up.z == 0))

    @dr.syntax
    def connect(
        self, a: mi.Point3f, n: mi.Normal3f, spot: mi.Point3f, spot_n: mi.Normal3f,
        number: mi.Float, active: mi.Bool,
    ) -> tuple[SpotConnection, mi.Float]:  # fmt: skip
        """Return the connection to an image of ``spot`` that the uniform ``number`` draws, and S.

        S is what all of its images send.
        """
        image = mi.UInt32(0)
        going = mi.Bool(active)
        none = SpotConnection(mi.Vector3f(0, 0, 1), mi.Float(0), mi.UInt32(NO_TURN), mi.Float(0))
        drawn = OneNumberReservoir.drawing(none, number)
        while going:
            row = [dr.gather(mi.Float, self.rows, 10 * image + i) for i in range(10)]
            if self.surfaces.bond is None:
                connection, weight = self._straight(row, a, n, spot, spot_n)
            else:
                connection, weight = self._over_bond(row, a, n, spot, spot_n)
            drawn = drawn.offered(connection, weight)
            image += 1
            going = going & (image < self.count)
        return drawn.item, drawn.total

    def _straight(
        self, row: list[mi.Float], a: mi.Point3f, n: mi.Normal3f, spot: mi.Point3f,
        spot_n: mi.Normal3f,
    ) -> tuple[SpotConnection, mi.Float]:  # fmt: skip
        """Return the connection to one image, and what that sends."""
        sign, shift = mi.Vector3f(row[0:3]), mi.Vector3f(row[3:6])
        span = sign * mi.Vector3f(spot) + shift - mi.Vector3f(a)
        squared = dr.maximum(dr.squared_norm(span), NEAREST)
        direction = span * dr.rsqrt(squared)
        leaving = dr.maximum(dr.dot(n, direction), 0.0)
        arriving = dr.maximum(-dr.dot(spot_n, sign * direction), 0.0)
        weight = leaving * arriving / squared
        for i in range(3):
            reflected = mi.fresnel(dr.abs(direction[i]), 1.0 / self.index)[0]
            for times in range(self.deepest if i == 2 else CELL_MAX):
                weight *= dr.select(row[6 + i] > times + 0.5, reflected, 1.0)
        clear = dr.sqrt(squared) - SLACK / arriving
        return SpotConnection(direction, clear, mi.UInt32(NO_TURN), row[9]), weight

    def _over_bond(
        self, row: list[mi.Float], a: mi.Point3f, n: mi.Normal3f, spot: mi.Point3f,
        spot_n: mi.Normal3f,
    ) -> tuple[SpotConnection, mi.Float]:  # fmt: skip
        """Return the same where a bond is between, or shows images itself."""
        bond = self.surfaces.bond
        assert bond is not None
        sign, shift = mi.Vector3f(row[0:3]), mi.Vector3f(row[3:6])
        begins_below, ends_below = a.z < 0, spot.z < 0
        below, across = begins_below & ends_below, begins_below != ends_below
        lower = row[5] < 0
        by_bond = (row[2] < 0) & ~lower
        bent = (lower & ~below) | across
        span = sign * mi.Vector3f(spot) + shift - mi.Vector3f(a)
        squared = dr.maximum(dr.squared_norm(span), NEAREST)
        # --------------------------- The line, and its light ---------------------------------
        pad = dr.maximum(a.z, 0.0) + dr.maximum(spot.z, 0.0)
        depth = dr.minimum(a.z, 0.0) + dr.minimum(spot.z, 0.0)
        way = way_through_bond(
            bond, span, pad, dr.select(lower, 2.0 * bond.thickness + depth, -depth)
        )
        straight = span * dr.rsqrt(squared)
        rise = dr.select(begins_below & ~lower, 1.0, -1.0)
        in_window = mi.Vector3f(
            way.direction.x / bond.ratio, way.direction.y / bond.ratio, rise * way.window_cos
        )
        in_pad = mi.Vector3f(way.direction.x, way.direction.y, rise * way.pad_cos)
        direction = dr.select(bent, dr.select(begins_below, in_window, in_pad), straight)
        arrives = dr.select(bent, dr.select(ends_below, in_window, in_pad), straight)
        leaving = dr.maximum(dr.dot(n, direction), 0.0)
        arriving = dr.maximum(-dr.dot(spot_n, sign * arrives), 0.0)
        # Solid angles and areas are those where the line begins and ends.
        steeper = way.window_cos / dr.maximum(way.pad_cos, 1e-6)
        spread = way.spread * dr.select(across, steeper, 1.0)
        spread *= dr.select(begins_below, dr.square(bond.ratio), 1.0)
        weight = leaving * arriving / dr.select(bent, spread, squared)
        weight *= dr.select(by_bond & across, 0.0, 1.0)
        # --------------------------- What it meets -------------------------------------------
        aside = dr.hypot(direction.x, direction.y)
        down = dr.select(begins_below, -1.0, a.z * aside / dr.maximum(way.pad_cos, 1e-6))
        up = dr.maximum(down, 0.0) + way.window_length * dr.hypot(in_window.x, in_window.y)
        walls = reflected_by_walls(
            bond, self.ways.box, self.ways.metal_sides, mi.Vector3f(a),
            direction * dr.select(begins_below, bond.ratio, 1.0),
            (
                dr.select(bent | below, down, dr.inf),
                dr.select(bent & ~ends_below, up, dr.inf),
            ),
            row[6:8],
        )  # fmt: skip
        steep = dr.abs(straight.z)
        window_cos = dr.select(bent, way.window_cos, steep)
        passed = bond.passed(way.pad_cos)
        reflected = mi.fresnel(window_cos, dr.rcp(bond.window))[0]
        weight *= walls.chance * dr.select(bent, passed, 1.0)
        weight *= dr.select(bent & ~across, passed, 1.0)
        weight *= dr.select(lower & (row[8] > 0.5), reflected, 1.0)
        at_bond = dr.select(
            below, mi.fresnel(steep, dr.rcp(bond.ratio))[0], 1.0 - bond.passed(steep)
        )
        weight *= dr.select(by_bond, at_bond, 1.0)
        length = dr.select(bent, way.pad_length + way.window_length, dr.sqrt(squared))
        turn = dr.select(by_bond, mi.UInt32(0), NO_TURN)
        return SpotConnection(direction, length - SLACK / arriving, turn, row[9]), weight

    def _square_of_window(self, p: mi.Point3f) -> mi.Float:
        """Return the squared index at ``p`` over that of the pad."""
        if self.surfaces.bond is None:
            return mi.Float(1.0)
        return dr.select(p.z < 0.0, dr.square(self.surfaces.bond.ratio), 1.0)


def survival_of(reflectance: mi.Float) -> mi.Float:
    """Return the chance of camera subpaths to go on from a diffuse vertex behind the facet."""
    return dr.clip(reflectance, SURVIVAL_MIN, SURVIVAL_MAX)
