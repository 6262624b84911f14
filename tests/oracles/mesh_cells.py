"""Transport cells of a bent scene by analog photons among the triangles of its pad.

As ``tests.oracles.analog_cells``, for any bend: the vertices are those of
``render.geometry.meshes``, the light is our own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse, stats

from render.geometry import camera_origin, fiber_poses, flat_fiber_poses
from render.geometry.meshes import pad_meshes
from render.scene import Scene
from tests.oracles.analog_cells import (
    AnalogCells,
    face_paint,
    face_roughness,
    finer_for_beams,
    rim_on,
    target_rays,
)
from tests.oracles.analog_tracer import BASE, LEFT, LOWER, RIGHT, TIP, UPPER, Floats, Lamp
from tests.oracles.mesh_lobe import trace_photons_to_mesh_sights
from tests.oracles.mesh_tracer import (
    AIR,
    BOND,
    CLEAR,
    COATED,
    INTERFACE,
    OUTER_CLEAR,
    OUTER_RIM,
    OUTER_WINDOW,
    RIM,
    WINDOW,
    Integers,
    MeshPad,
    trace_photons_on_mesh,
    trace_views_on_mesh,
)
from tests.oracles.skin_lobe import Sights, sights_by_bin

CELL = 0.8
"""Size of the cells that sort the triangles, mm."""
PITCH = 0.25
"""Longest side of a tally bin where beams are wide, mm."""
OVERSAMPLING = 16


def mesh_pad(scene: Scene, bend: float, *, indented: bool) -> MeshPad:
    """Return the pad of ``scene`` at ``bend`` rad, pressed at all sites or untouched."""
    meshes, layer = pad_meshes(scene, bend, indented), scene.diffuser
    parts = {
        COATED: meshes.coating,
        OUTER_CLEAR: meshes.outer_clear,
        OUTER_RIM: meshes.outer_diffuser,
        INTERFACE: meshes.interface,
    }
    if meshes.window is not None:
        parts |= {BOND: meshes.window.bond, OUTER_WINDOW: meshes.window.outer}
    corners, kinds = [], []
    for kind, mesh in parts.items():
        if mesh is not None:
            corners.append(np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces])
            kinds.append(np.full(len(mesh.faces), kind))
    corner, kind_of = np.concatenate(corners), np.concatenate(kinds)
    edges = corner[:, 1:] - corner[:, :1]
    normal = np.cross(edges[:, 0], edges[:, 1])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    pitch = PITCH / finer_for_beams(scene)
    splits = np.where(
        (kind_of == COATED)[:, None],
        np.maximum(1, np.ceil(np.linalg.norm(edges, axis=-1) / pitch)),
        0,
    ).astype(np.int64)
    bins = splits.prod(axis=1)
    low, cell, shape, start, member = _sorted(corner)
    side = _faces_of(scene, bend, corner.mean(axis=1), normal)
    paint, reflectance = face_paint(scene)
    return MeshPad(
        corner=np.ascontiguousarray(corner[:, 0]),
        first=np.ascontiguousarray(edges[:, 0]),
        second=np.ascontiguousarray(edges[:, 1]),
        normal=normal,
        kind=kind_of,
        low=low,
        cell=cell,
        shape=shape,
        start=start,
        member=member,
        index=scene.pad.index,
        window=scene.window.index if scene.window else 1.0,
        alpha=face_roughness(scene)[side],
        paint=paint[side],
        reflectance=reflectance[side],
        sigma_s=layer.sigma_s if layer else 0.0,
        sigma_a=layer.sigma_a if layer else 0.0,
        g=layer.g if layer else 0.0,
        albedo=scene.coating.albedo,
        specular=scene.coating.specular or 0.0,
        lobe=scene.coating.roughness or 1.0,
        splits=splits,
        bin=np.concatenate([[0], np.cumsum(bins)])[:-1],
    )


def _faces_of(scene: Scene, bend: float, middle: Floats, normal: Floats) -> Integers:
    """Return the face of the box that triangles are on once it is bent, by their normals.

    Those of faces to the air point outwards; what others get means nothing.
    """
    down = np.tile([0.0, 0.0, -1.0], (len(middle), 1))
    if bend:
        axis = np.array([0.0, scene.camera.pivot, scene.pad.thickness + scene.pad.length / bend])
        down = (middle - axis) * [0.0, 1.0, 1.0]
        down /= np.linalg.norm(down, axis=-1, keepdims=True)
    ahead = np.stack([down[:, 0], -down[:, 2], down[:, 1]], axis=-1)
    outwards = [normal[:, 0], (normal * ahead).sum(axis=-1), (normal * down).sum(axis=-1)]
    towards = np.stack([-outwards[0], outwards[0], -outwards[1], outwards[1], outwards[2]], axis=-1)
    towards = np.column_stack([towards, -outwards[2]])
    return np.array([LEFT, RIGHT, BASE, TIP, LOWER, UPPER])[towards.argmax(axis=-1)]


def _sorted(corner: Floats) -> tuple[Floats, Floats, Integers, Integers, Integers]:
    """Sort triangles ``(face, 3, 3)`` into the cells of a grid, by their bounding boxes."""
    low, high = corner.min(axis=(0, 1)) - 1e-3, corner.max(axis=(0, 1)) + 1e-3
    shape = np.maximum(1, np.ceil((high - low) / CELL)).astype(np.int64)
    cell = (high - low) / shape
    # A hair wider, so that rounding leaves no face out.
    first = np.floor((corner.min(axis=1) - 1e-6 - low) / cell).astype(np.int64)
    last = np.floor((corner.max(axis=1) + 1e-6 - low) / cell).astype(np.int64)
    first, last = np.clip(first, 0, shape - 1), np.clip(last, 0, shape - 1)
    cells, faces = [], []
    for face in range(len(corner)):
        x, y, z = (np.arange(first[face, k], last[face, k] + 1) for k in range(3))
        grid_z, grid_y, grid_x = np.meshgrid(z, y, x, indexing="ij")
        cells.append(((grid_z * shape[1] + grid_y) * shape[0] + grid_x).ravel())
        faces.append(np.full(cells[-1].size, face))
    cell_of, face_of = np.concatenate(cells), np.concatenate(faces)
    order = np.argsort(cell_of, kind="stable")
    counts = np.bincount(cell_of, minlength=int(shape.prod()))
    start = np.concatenate([[0], np.cumsum(counts)])
    return low, cell, shape, start, face_of[order]


def mesh_bin_areas(pad: MeshPad) -> Floats:
    """Return the area of every tally bin ``(bin,)`` in mm^2; 0 beyond a triangle's third edge."""
    doubled = np.linalg.norm(np.cross(pad.first, pad.second), axis=-1)
    step = (np.arange(OVERSAMPLING) + 0.5) / OVERSAMPLING
    areas = []
    for face in np.nonzero(pad.kind == COATED)[0]:
        m, n = pad.splits[face]
        u = ((np.arange(m)[:, None] + step) / m).ravel()
        v = ((np.arange(n)[:, None] + step) / n).ravel()
        # Points on the edge itself count half.
        within = np.heaviside(1.0 - 1e-12 - u[:, None] - v[None, :], 0.5)
        within += 0.5 * (np.abs(u[:, None] + v[None, :] - 1.0) <= 1e-12)
        part = within.reshape(m, OVERSAMPLING, n, OVERSAMPLING).mean(axis=(1, 3))
        areas.append(doubled[face] * part.ravel() / (m * n))
    return np.concatenate(areas)


@dataclass(frozen=True)
class BentScene:
    """One pad at ``bend`` rad and what its camera sees of it; as ``AnalogScene``."""

    scene: Scene
    bend: float
    indented: bool = True
    views: int = 20_000
    seed: int = 1

    @cached_property
    def pad(self) -> MeshPad:
        """The pad that photons move in."""
        return mesh_pad(self.scene, self.bend, indented=self.indented)

    @cached_property
    def area(self) -> Floats:
        """Areas of the tally bins ``(bin,)``, mm^2."""
        return mesh_bin_areas(self.pad)

    @cached_property
    def sights(self) -> tuple[Sights, Integers]:
        """The rays of all targets by the bin that they see, and targets that nothing shows."""
        found, dark = [], []
        rays = target_rays(self.scene, self.bend, self.indented, self.views, self.seed)
        for target, directions in enumerate(rays):
            if directions is None:
                dark.append(target)
                continue
            bins, arrived, weight = trace_views_on_mesh(
                self.pad, camera_origin(self.scene), directions, self.seed + target
            )
            found.append((bins, arrived, weight / self.views, np.full(len(bins), target)))
        bins, arrived, weight, owner = (np.concatenate(part) for part in zip(*found, strict=True))
        return (
            sights_by_bin(bins, arrived, weight, owner, len(self.area)),
            np.array(dark, dtype=np.int64),
        )

    @cached_property
    def view(self) -> sparse.csr_matrix:
        """Mean weight with which a ray of a target sees each bin, ``(target, bin)``."""
        sights, dark = self.sights
        bins = np.repeat(np.arange(len(self.area)), np.diff(sights.first))
        targets = self.scene.sites.count * (self.scene.indenter.faces if self.indented else 1)
        weights = np.concatenate([sights.weight, np.full(len(dark), np.nan)])
        rows = np.concatenate([sights.target, dark])
        columns = np.concatenate([bins, np.zeros(len(dark), dtype=np.int64)])
        return sparse.csr_matrix((weights, (rows, columns)), shape=(targets, len(self.area)))

    def lamp(self, fiber: int, phi: float) -> Lamp:
        """Return fiber ``fiber`` pointing in direction ``phi`` (rad)."""
        poses, lamp = fiber_poses(self.scene, self.bend), self.scene.placed_lamps()[fiber]
        beam = poses.directions(np.full(self.scene.lamp_count, phi))[fiber]
        across = np.cross(beam, poses.up[fiber])
        across /= np.linalg.norm(across)
        frame = np.stack([across, np.cross(across, beam), beam], axis=-1)
        return Lamp(
            poses.position[fiber], np.ascontiguousarray(frame), lamp.diameter / 2,
            lamp.profile.sigma_v or 1.0, lamp.profile.cosine_exponent or 0.0,
        )  # fmt: skip

    def place(self, fiber: int) -> int:
        """Return what a fiber is in: in the flat frame, by the scene's numbers."""
        pad, plate = self.scene.pad, self.scene.window
        x, y, z = flat_fiber_poses(self.scene).position[fiber]
        out = np.array([-x, x, -y, y]) - np.repeat([pad.width / 2, pad.length / 2], 2)
        rims = [rim_on(self.scene, edge) for edge in ("left", "right", "base", "tip")]
        if (out >= rims).any() or z >= pad.thickness:
            return AIR
        if z > 0.0:
            return CLEAR if (out < 0.0).all() else RIM
        return WINDOW if plate and z > -plate.thickness else AIR

    def cells(self, fiber: int, phi: float, photons: int, batches: int = 16) -> AnalogCells:
        """Return the transport of one fiber in direction ``phi`` (rad) to all targets."""
        lamp, place, bins = self.lamp(fiber, phi), self.place(fiber), len(self.area)
        first = (self.seed * 1009 + fiber) * 4099
        area = np.where(self.area > 0, self.area, np.inf)
        coating, each = self.scene.coating, photons // batches
        replicates = []
        for seed in range(first, first + batches):
            lobe: Floats | float = 0.0
            if coating.specular:
                power, lobe, _ = trace_photons_to_mesh_sights(
                    self.pad, lamp, place, each, seed, area, self.sights[0], self.view.shape[0]
                )
            else:
                power, _ = trace_photons_on_mesh(self.pad, lamp, place, each, seed, bins)
            diffuse = coating.albedo / np.pi * (self.view @ (power / area))
            replicates.append((diffuse + lobe) / self.scene.pad.index**2)
        cells = np.array(replicates)
        return AnalogCells(cells.mean(axis=0), stats.sem(cells, axis=0), cells)
