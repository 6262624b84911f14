"""Transport cells of a flat clear pad with smooth faces: one population of light for all lamps.

Without a medium the skin and white paint scatter light, and nothing else. Camera subpaths go from
one such vertex to the next, over smooth faces that reflect by chance. At each they are joined to
lamps over the faces (``render.cells.clear.lamp_ways``), to all of them at the facet: a camera
subpath does not know its lamp, so it serves all. They are connected to where light subpaths met
skin or paint first as well (``render.cells.clear.lamp_spots``), and what they meet behind the faces
counts too, all by the balance heuristic (Veach 1997, sec. 9.2). A sample is of all cells: every
facet of every site gets a few camera subpaths, spread over its pixels.

Radiances are *basic*: over the square of the index, so that refraction leaves them as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array
from render.cells.cell_sampler import TargetPixels, Targets, pixel_rays
from render.cells.clear.bond_optics import WindowBond
from render.cells.clear.bonded_ways import BondedWays
from render.cells.clear.lamp_spots import LampSpots, Spots, survival_of
from render.cells.clear.lamp_ways import LampLine, LampWays, wrapped
from render.cells.clear.pad_surfaces import BOND, DIELECTRIC, DIFFUSE, PadSurfaces, step_off
from render.cells.fiber_light import FiberLight
from render.geometry import counted_sites
from render.optics.pad_scene import pad_scene
from render.sampling.proposals import CellSplat
from render.sampling.streams import Stream
from render.scene import Scene

MAX_VALUES = 1 << 24
"""Radiances that are in memory at once, per node, lamp and camera subpath."""
EVENTS = 4096
"""Events by which the numbers of camera subpaths are apart."""
VERTEX_EVENTS = 32
"""Events by which those of two diffuse vertices are apart: as many faces may reflect between."""
VERTEX_MAX = 100
"""Diffuse vertices of a camera subpath."""
STEP = (0.7548776662466927, 0.5698402909980532)
"""By which the points on lamps' ends differ from one way to the next (R2 sequence)."""


@dataclass
class _Chain:
    """How a camera subpath came from a diffuse vertex (a Dr.Jit PyTree).

    ``before`` is the length in the pad since then and ``below`` that in a window, ``density`` that
    of its direction there times the chance of all that happened since, ``counts`` how often each
    axis reflected and ``up`` whether the direction goes up the axis. ``kappa`` is how likely light
    subpaths find the vertex, as in ``render.cells.clear.lamp_spots``.
    """

    before: mi.Float
    below: mi.Float
    density: mi.Float
    counts: mi.Vector3u
    up: mi.Vector3u
    kappa: mi.Float


class ClearCells:
    """All cells of one flat pad, indented or untouched, as a sampler of ``MonteCarlo``."""

    def __init__(
        self, scene: Scene, phi: Array, indented: bool, targets: Targets, strata: int
    ) -> None:
        """Load the pad; ``phi`` is ``(fiber, node)`` rad."""
        self.scene, self.targets, self.strata = scene, targets, strata
        self.pad = pad_scene(scene, 0.0, indented)
        self.bond = WindowBond(scene) if scene.window_refracts else None
        self.surfaces = PadSurfaces(self.pad, self.bond)
        self.light = FiberLight(scene, phi, 0.0)
        self.ways: LampWays
        if self.bond is None:
            self.ways = LampWays(scene, self.light)
        else:
            self.ways = BondedWays(scene, self.light, self.bond)
        self.sites = len(counted_sites(scene))
        self.faces = max(1, targets.count // self.sites)
        paths = self.sites * strata
        self.spots = LampSpots(scene, self.surfaces, self.light, self.ways, strata, paths)
        self.index = scene.pad.index
        self.fibers, self.channels = phi.shape
        self.bins = self.fibers * targets.count
        self.pixels = TargetPixels(scene, targets)

    def evaluate(self, camera: Stream, light: Stream) -> list[CellSplat]:
        """Return what one sample per lane adds to all cells: radiance per direction node."""
        lanes = dr.width(camera.event(mi.UInt32(0)))
        count, kinds = self.targets.count, (self.fibers, self.channels)
        spots = self.spots.trace(light, lanes)
        dr.eval(spots)
        found = np.zeros((*kinds, count, lanes))
        each = min(count, max(1, MAX_VALUES // (lanes * self.strata * self.bins // count)))
        for begin in range(0, count, each):
            here = min(each, count - begin)
            # The lanes of one target and stratum lie side by side.
            wide = dr.arange(mi.UInt32, lanes * here * self.strata)
            subpath = wide // lanes
            start = mi.UInt32(begin * self.strata)
            dr.make_opaque(start)
            lane = wide - subpath * lanes
            subpath += start
            # All facets of a site share its light subpaths, those of other sites have others.
            site = dr.minimum(subpath // self.strata // self.faces, self.sites - 1)
            # Strata of light subpaths divide directions and those of camera subpaths pixels: each
            # pair of them must be as likely as any other, so one is turned against the other.
            numbers = camera.of_lanes(lane)
            first = subpath // self.strata * (self.strata * EVENTS)
            turn = mi.UInt32(numbers.event(first + 1)[0] * self.strata)
            spot = (site * self.strata + (subpath + turn) % self.strata) * lanes + lane
            values = self._values(subpath, numbers, spots, spot)
            shape = (*kinds, here, self.strata, lanes)
            found[:, :, begin : begin + here] = np.array(values).reshape(shape).mean(axis=3)
        return [CellSplat(found.swapaxes(1, 2).reshape(self.bins, self.channels, lanes))]

    @dr.syntax
    def _values(
        self, subpath: mi.UInt32, stream: Stream, spots: Spots, spot: mi.UInt32
    ) -> mi.Float:
        """Return radiances per fiber, node and lane, flat, of one camera subpath per lane."""
        width = dr.width(subpath)
        # Dr.Jit 1.5 adds to one array from one place only.
        size = self.fibers * self.channels * width
        joined, met, spotted = (dr.zeros(mi.Float, size) for _ in range(3))
        lane = dr.arange(mi.UInt32, width)
        first = subpath * EVENTS
        p, d, beta = self._camera_ray(subpath, stream, first)
        # --------------------------- Configure loop state ----------------------------
        vertex = mi.UInt32(0)  # diffuse vertices so far
        reflections = mi.UInt32(0)  # since the last of them
        chain = _Chain(
            mi.Float(0), mi.Float(0), mi.Float(0), mi.Vector3u(0), mi.Vector3u(0), mi.Float(0)
        )
        # The diffuse vertex before, and its chance to survive.
        last, last_n, survived = dr.zeros(mi.Point3f), dr.zeros(mi.Normal3f), mi.Float(1)
        active = beta > 0
        while active:
            hit = self.surfaces.hit(p, d, active)
            active = active & hit.valid
            run = dr.select(active, dr.norm(hit.p - p), 0.0)
            in_window = self.surfaces.in_window(p, hit.p)
            chain.before += dr.select(in_window, 0.0, run)
            chain.below += dr.select(in_window, run, 0.0)
            base = first + 2 + vertex * VERTEX_EVENTS
            event = base + reflections
            kind, inward = hit.kind, -hit.cosine
            diffuse = active & (kind == DIFFUSE)
            # Behind paint and skin it is dark.
            active = active & (~diffuse | (inward > 0))
            diffuse = diffuse & active
            if diffuse:
                a = step_off(hit.p, hit.n)
                scale = beta * hit.reflectance / dr.pi
                survival = survival_of(hit.reflectance)
                survival = dr.select(vertex == 0, 1.0, survival)
                known = (vertex > 0) & self.spots.known(chain.counts, chain.up)
                kappa = self.spots.likelihood(last, last_n, survived, a, hit.n, survival, known)
                last, last_n, survived = a, hit.n, survival
                self._connect(spotted, lane, spots, spot, a, hit.n, scale, survival, stream, base)
                self._join(
                    joined, lane, a, hit.n, scale, survival, kappa, vertex == 0, stream, base
                )
                # ------------------------- Go on by the cosine ------------------------
                free, _, x, y = stream.event(event)
                local = mi.warp.square_to_cosine_hemisphere(mi.Point2f(x, y))
                d = mi.Frame3f(hit.n).to_world(local)
                beta *= hit.reflectance / survival
                p = a
                vertex += 1
                reflections = mi.UInt32(0)
                up = mi.Vector3u(*(dr.select(d[i] > 0, mi.UInt32(1), 0) for i in range(3)))
                counts = mi.Vector3u(0, 0, self.surfaces.begin(a))
                chain = _Chain(
                    mi.Float(0), mi.Float(0), survival * dr.maximum(local.z, 1e-6) / dr.pi,
                    counts, up, kappa,
                )  # fmt: skip
                active = active & (free < survival) & (hit.reflectance > 0)
                active = active & (vertex < VERTEX_MAX)
            else:
                cosine = dr.abs(hit.cosine)
                index = self.surfaces.index_at(hit.p, self.index)
                fresnel, outside, _, _ = mi.fresnel(cosine, 1.0 / index)
                number = stream.event(event)[0]
                boundary = kind == DIELECTRIC
                leaves = active & boundary & (number >= fresnel)
                if leaves & (vertex > 0):
                    # From inside, the normal is on the far side.
                    beyond = mi.Vector3f(index * d + (dr.abs(outside) - index * cosine) * hit.n)
                    line = self.ways.leaving(
                        last, hit.p, hit.n, d, beyond, chain.before, chain.below, cosine,
                        dr.abs(outside),
                    )  # fmt: skip
                    chain.density *= 1.0 - fresnel
                    self._meet(met, lane, line, chain, hit.n, beta, vertex == 1)
                onward = self.surfaces.inside(hit, d, number)
                beta *= dr.select(boundary, 1.0, hit.reflectance)
                chain.density *= dr.select(boundary, fresnel, onward.chance)
                chain.counts += onward.counts
                p = dr.select(active, onward.p, p)
                d = dr.select(active, onward.d, d)
                reflections += 1
                active = active & ~leaves & (reflections < VERTEX_EVENTS - 1)
        return joined + met + spotted

    def _camera_ray(
        self, subpath: mi.UInt32, stream: Stream, first: mi.UInt32
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Float]:
        """Return origin and direction behind the face that the camera looks through, and weight."""
        target = subpath // self.strata
        stratum = subpath - target * self.strata
        pick, _, x, y = stream.event(first)
        number = (mi.Float(stratum) + pick) / self.strata
        column, row = self.pixels.place(target, number, x, y)
        film = self.scene.camera
        o, d = pixel_rays(self.scene, column, row, film.columns, film.rows)
        hit = self.surfaces.hit(o, d, dr.full(mi.Bool, True, dr.width(subpath)))
        # What the face reflects is lost, so that nothing is left to chance.
        cosine = -hit.cosine
        index = self.surfaces.index_at(hit.p, self.index)
        fresnel, _, _, _ = mi.fresnel(cosine, index)
        inside = dr.sqrt(1.0 - (1.0 - dr.square(cosine)) / index**2)
        refracted = d / index + (cosine / index - inside) * mi.Vector3f(hit.n)
        enters = hit.valid & (hit.kind == DIELECTRIC) & (cosine > 0)
        weight = dr.select(enters, 1.0 - fresnel, 0.0)
        p, d = step_off(hit.p, -hit.n), dr.normalize(refracted)
        if self.bond is None:
            return p, d, weight
        # The same at the bond.
        hit = self.surfaces.hit(p, d, enters)
        onward = self.surfaces.inside(hit, d, mi.Float(0.0))
        weight *= dr.select(hit.valid & (hit.kind == BOND), onward.chance, 0.0)
        return onward.p, onward.d, weight

    @dr.syntax
    def _join(
        self, sums: mi.Float, lane: mi.UInt32, a: mi.Point3f, n: mi.Normal3f, scale: mi.Float,
        survival: mi.Float, kappa: mi.Float, facet: mi.Bool, stream: Stream, base: mi.UInt32,
    ) -> None:  # fmt: skip
        """Add the light of lamps joined to diffuse vertices ``a``."""
        ways, draws = self.ways, self.ways.draws
        in_window = self.surfaces.in_window(a, a)
        pick, way, x, y = stream.event(base + (VERTEX_EVENTS - 1))
        step = mi.UInt32(0)
        last = dr.select(facet, mi.UInt32(draws.facet_count), mi.UInt32(self.fibers))
        going = step < last
        while going:
            turn = mi.Float(step)
            number = wrapped(way + turn * 0.6180339887498949)
            main, lamp = draws.at_facet(step, number)
            lamp = dr.select(facet, lamp, step)
            later = draws.later(dr.minimum(step, self.fibers - 1), number, in_window)
            entry = dr.select(facet, main, later)
            square = mi.Point2f(wrapped(x + turn * STEP[0]), wrapped(y + turn * STEP[1]))
            found = ways.join(entry, lamp, a, wrapped(pick + turn * 0.41421356237), square)
            cosine = dr.dot(n, found.direction)
            valid = going & found.valid & (cosine > 0)
            if valid:
                carried = ways.along(lamp, found.line)
                radiance = carried.radiance
                density = carried.joined * draws.probability(entry, facet)
                by_chance = survival * cosine / dr.pi * found.chance
                by_chance *= 1.0 + kappa * carried.emitted
                value = scale * cosine * found.through / (density + by_chance)
                lit = valid & (density > 0)
                if lit:
                    lit = ~self.surfaces.blocked(
                        a, found.direction, found.line.before, found.turn, lit
                    )
                for j in range(self.channels):
                    at = (lamp * self.channels + j) * dr.width(lane) + lane
                    dr.scatter_reduce(
                        dr.ReduceOp.Add, sums, value * radiance[j], at,
                        lit & (radiance[j] > 0), mode=dr.ReduceMode.NoConflicts,
                    )  # fmt: skip
            step += 1
            going = going & (step < last)

    @dr.syntax
    def _connect(
        self, sums: mi.Float, lane: mi.UInt32, spots: Spots, number: mi.UInt32, a: mi.Point3f,
        n: mi.Normal3f, scale: mi.Float, survival: mi.Float, stream: Stream, base: mi.UInt32,
    ) -> None:  # fmt: skip
        """Add the light of each lamp's spot ``number``, connected to diffuse vertices ``a``."""
        size = dr.width(spots.others) // self.fibers
        random = stream.event(base + (VERTEX_EVENTS - 1))[0]
        lamp = dr.zeros(mi.UInt32, dr.width(lane))
        while lamp < self.fibers:
            spot = dr.gather(Spots, spots, lamp * size + number)
            sends = spot.others > 0
            if sends:
                pick = wrapped(random + mi.Float(lamp) * 0.7320508075688772)
                found, total = self.spots.connect(a, n, spot.p, spot.n, pick, sends)
                lit = sends & (total > 0)
                if lit:
                    lit = ~self.surfaces.blocked(a, found.direction, found.clear, found.turn, lit)
                value = scale * found.metal * total
                value /= 1.0 + survival * total * spot.others
                for j in range(self.channels):
                    dr.scatter_reduce(
                        dr.ReduceOp.Add, sums, value * spot.sent[j],
                        (lamp * self.channels + j) * dr.width(lane) + lane,
                        lit & (spot.sent[j] > 0), mode=dr.ReduceMode.NoConflicts,
                    )  # fmt: skip
            lamp += 1

    @dr.syntax
    def _meet(
        self, sums: mi.Float, lane: mi.UInt32, line: LampLine, chain: _Chain, n: mi.Normal3f,
        beta: mi.Float, facet: mi.Bool,
    ) -> None:  # fmt: skip
        """Add the light of lamps that subpaths meet behind a face with normal ``n``."""
        code = self.ways.code(chain.counts, chain.up, n)
        lamp = dr.zeros(mi.UInt32, dr.width(lane))
        while lamp < self.fibers:
            carried = self.ways.along(lamp, line)
            radiance = carried.radiance
            entry = self.ways.entry(lamp, code)
            joined = carried.joined * self.ways.draws.probability(entry, facet)
            by_light = chain.density * chain.kappa * carried.emitted
            value = beta * chain.density / (chain.density + joined + by_light)
            for j in range(self.channels):
                at = (lamp * self.channels + j) * dr.width(lane) + lane
                dr.scatter_reduce(
                    dr.ReduceOp.Add, sums, value * radiance[j], at, radiance[j] > 0,
                    mode=dr.ReduceMode.NoConflicts,
                )  # fmt: skip
            lamp += 1
