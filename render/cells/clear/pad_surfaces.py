"""What a ray meets on a pad of smooth faces: the kind, normal and reflectance of every triangle.

Where all faces are smooth, metal or diffuse, Mitsuba only has to say which triangle comes first:
Fresnel's equations need the normal alone, and no BSDF is called.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from render.cells.clear.bond_optics import WindowBond, through_bond

DIFFUSE, DIELECTRIC, METAL, BOND = range(4)
BOND_PASSED, LOWER_MET, BOND_MET, FROM_WINDOW = 1, 3, 9, 1 << 16
"""What bond, lower face and a begin in the window add to the counts along z where there is a bond:
no two of the ways that are told apart have the same."""
NO_TURN = 1 << 16
"""The turn of lines that no bond reflects."""


@dataclass
class SurfaceHit:
    """The surface that a ray meets (a Dr.Jit PyTree): ``n`` is its unit normal.

    ``cosine`` is that between the normal and the ray, negative on the side of the normal;
    ``reflectance`` is 1 where the surface is a smooth boundary.
    """

    p: mi.Point3f
    n: mi.Normal3f
    cosine: mi.Float
    kind: mi.UInt32
    reflectance: mi.Float
    valid: mi.Bool


@dataclass
class Onward:
    """How light goes on in the silicone (a Dr.Jit PyTree).

    ``chance`` is that of what happened at a bond; ``counts`` how often each axis reflected.
    """

    p: mi.Point3f
    d: mi.Vector3f
    chance: mi.Float
    counts: mi.Vector3u


class PadSurfaces:
    """The triangles of a loaded pad whose BSDFs are ``diffuse``, ``dielectric`` or ``conductor``.

    Normals of dielectrics point into the air, others into the silicone, as in
    ``render.optics.pad_scene``.
    """

    def __init__(self, scene: mi.Scene, bond: WindowBond | None = None) -> None:
        """Read normals and reflectances from the shapes of ``scene``."""
        self.scene, self.bond = scene, bond
        number = np.array(dr.reinterpret_array(mi.UInt32, scene.shapes_dr()))
        kind, reflectance = (np.zeros(number.max() + 1, dtype=np.float32) for _ in range(2))
        first = np.zeros(number.max() + 1, dtype=np.uint32)
        normals: list[np.ndarray] = []
        for shape, at in zip(scene.shapes(), number, strict=True):
            kind[at], reflectance[at] = _surface(shape.bsdf())
            if bond is not None and shape.id() == "bond":
                kind[at] = BOND
            first[at] = sum(len(part) for part in normals)
            normals.append(_normals(shape))
        normal = np.concatenate(normals).astype(np.float32)
        self.normal = mi.Float(normal.ravel())
        self.kind, self.first = mi.UInt32(kind.astype(np.uint32)), mi.UInt32(first)
        self.reflectance = mi.Float(reflectance)
        dr.make_opaque(self.normal, self.kind, self.first, self.reflectance)

    def hit(self, o: mi.Point3f, d: mi.Vector3f, active: mi.Bool) -> SurfaceHit:
        """Return what rays ``(o, d)`` meet first."""
        found = self.scene.ray_intersect_preliminary(mi.Ray3f(o, d), coherent=False, active=active)
        valid = active & found.is_valid()
        shape = dr.reinterpret_array(mi.UInt32, found.shape)
        triangle = dr.gather(mi.UInt32, self.first, shape, valid) + found.prim_index
        n = dr.gather(mi.Normal3f, self.normal, triangle, valid)
        return SurfaceHit(
            p=mi.Point3f(o + dr.select(valid, found.t, 0.0) * d), n=n, cosine=dr.dot(n, d),
            kind=dr.gather(mi.UInt32, self.kind, shape, valid),
            reflectance=dr.gather(mi.Float, self.reflectance, shape, valid), valid=valid,
        )  # fmt: skip

    def index_at(self, p: mi.Point3f, index: float) -> mi.Float | float:
        """Return the index at ``p`` where that of the pad is ``index``."""
        return index if self.bond is None else self.bond.index_at(p)

    def in_window(self, a: mi.Point3f, b: mi.Point3f) -> mi.Bool:
        """Return whether the line between two neighbors is in a window of another index."""
        return mi.Bool(False) if self.bond is None else a.z + b.z < 0.0

    def begin(self, p: mi.Point3f) -> mi.UInt32:
        """Return the count along z of chains that begin at ``p``."""
        in_window = self.in_window(p, p)
        return dr.select(in_window, mi.UInt32(FROM_WINDOW), 0)

    def inside(self, hit: SurfaceHit, d: mi.Vector3f, number: mi.Float) -> Onward:
        """Return how light along ``d`` goes on in the silicone: reflected, or through the bond.

        The uniform ``number`` decides that.
        """
        inner = dr.select(hit.kind == DIELECTRIC, -1.0, 1.0) * hit.n
        turned = d - 2.0 * hit.cosine * mi.Vector3f(hit.n)
        counts = mi.Vector3u(
            *(dr.select(dr.abs(hit.n[i]) > 0.5, mi.UInt32(1), 0) for i in range(3))
        )
        if self.bond is None:
            return Onward(step_off(hit.p, inner), turned, mi.Float(1.0), counts)
        bond = hit.kind == BOND
        onward, passed = through_bond(d, self.bond.ratio)
        passes = bond & (number < passed)
        inner = dr.select(bond, dr.mulsign(1.0, hit.cosine) * dr.select(passes, 1.0, -1.0), 1.0) * (
            dr.select(bond, mi.Normal3f(hit.n), inner)
        )
        level = dr.select(bond, dr.select(passes, mi.UInt32(BOND_PASSED), BOND_MET), LOWER_MET)
        counts.z = dr.select(counts.z > 0, level, 0)
        chance = dr.select(bond, dr.select(passes, passed, 1.0 - passed), 1.0)
        return Onward(step_off(hit.p, inner), dr.select(passes, onward, turned), chance, counts)

    @dr.syntax
    def blocked(
        self, a: mi.Point3f, direction: mi.Vector3f, length: mi.Float, turn: mi.UInt32,
        active: mi.Bool,
    ) -> mi.Bool:  # fmt: skip
        """Return whether skin is in the way of lines from ``a`` through the unfolded pad.

        They pass bonds, but for the one that they meet as number ``turn``, which reflects them.
        """
        o, d, left = mi.Point3f(a), mi.Vector3f(direction), mi.Float(length)
        blocked = mi.Bool(False)
        going = mi.Bool(active)
        bonds = mi.UInt32(0)
        while going:
            hit = self.hit(o, d, going)
            run = dr.norm(hit.p - o)
            going = going & hit.valid
            blocked |= going & (hit.kind == DIFFUSE) & (run < left - 1e-3)
            left -= run
            going = going & ~blocked & (left > 1e-2)
            onward = self.inside(hit, d, dr.select(bonds == turn, mi.Float(1.0), 0.0))
            bonds += dr.select(hit.kind == BOND, mi.UInt32(1), 0)
            o, d = onward.p, onward.d
        return blocked


def step_off(p: mi.Point3f, n: mi.Vector3f) -> mi.Point3f:
    """Return ``p`` a little to the side that ``n`` points to, where rays do not meet it again."""
    return mi.Point3f(p + (1.0 + dr.max(dr.abs(p))) * mi.math.RayEpsilon * mi.Vector3f(n))


def _surface(bsdf: mi.BSDF) -> tuple[int, float]:
    flags, si = bsdf.flags(), dr.zeros(mi.SurfaceInteraction3f)
    if mi.has_flag(flags, mi.BSDFFlags.Diffuse):
        return DIFFUSE, float(np.array(bsdf.eval_diffuse_reflectance(si)).ravel()[0])
    if mi.has_flag(flags, mi.BSDFFlags.DeltaTransmission):
        return DIELECTRIC, 1.0
    si.wi = mi.Vector3f(0, 0, 1)
    _, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(0.5, 0.5))
    return METAL, float(np.array(weight).ravel()[0])


def _normals(mesh: mi.Mesh) -> np.ndarray:
    """Return the unit normals ``(triangle, 3)`` of a mesh, float64."""
    content = mi.traverse(mesh)
    corners = np.array(content["vertex_positions"], dtype=np.float64).reshape(-1, 3)
    faces = np.array(content["faces"]).reshape(-1, 3)
    a, b, c = (corners[faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30))
