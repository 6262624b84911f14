"""Training cells: what the residual must be, how well it is known, and which cells belong together.

Axes of every array here: ``(direction, fiber, bend, site, normal)``. The rows of one direction
index form one lighting pattern with its own phi per fiber, so that the arrays line up with a batch
of the checker; the normals are the facets, then the untouched pad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.errors import TableError
from render.geometry.layout import flat_fiber_poses
from render.scene.schema import Scene
from render.transport import TransportTable
from surrogate.model.facet_basis import mirror_signs

UNRELIABLE = 0.5
"""Relative standard error from which a single cell is no yardstick; it is still fitted to."""


@dataclass(frozen=True)
class Cells:
    """Reference transport as training data.

    Arguments:
        phi: ``(direction, fiber)`` rad; bends: ``(bend,)`` rad.
        transport, error: reference and its standard error, ``(direction, fiber, bend, site,
            normal)``.
        group: ``(direction, fiber, bend)`` integers; mirror twins share a group.
        fiber_group, direction_group, bend_group: the same shape, coarser groups.
        block: ``(direction,)`` which material the cells of a direction are of.
        material: ``(direction, quantity)`` that material, where the scene leaves it free.
    """

    phi: Array
    bends: Array
    transport: Array
    error: Array
    group: np.ndarray
    fiber_group: np.ndarray
    direction_group: np.ndarray
    bend_group: np.ndarray
    block: np.ndarray
    material: Array | None = None

    @property
    def material_group(self) -> np.ndarray:
        """The block in the shape of the other groups."""
        return np.broadcast_to(self.block[:, None, None], self.group.shape)

    @property
    def reliable(self) -> np.ndarray:
        """True where the cell is positive and its relative error is below UNRELIABLE."""
        return (self.transport > 0) & (self.error < UNRELIABLE * self.transport)


def cells_from_table(scene: Scene, table: TransportTable) -> Cells:
    """Return the training cells of a reference table with background.

    Raises:
        TableError: when the table lacks bends or background or does not fit the scene.
    """
    expected = (scene.fibers.count, scene.sites.count, scene.indenter.faces)
    found = (table.T.shape[0], *table.T.shape[3:])
    if found != expected:
        raise TableError(
            f"the reference table has (fiber, site, facet) = {found}, allowed: {expected} as in "
            f"the scene {scene.name}: render it for this scene",
            field="T",
            value=found,
        )
    if table.background is None or table.background_se is None:
        raise TableError(
            "the reference table has no background: render it together with the facets",
            field="background",
        )
    if table.bends.shape != (table.T.shape[2],):
        raise TableError(
            f"the reference table names {table.bends.size} bends for {table.T.shape[2]}: "
            "store its bends",
            field="bends",
        )
    transport = np.concatenate([table.T, table.background[..., None]], axis=-1)
    error = np.concatenate([table.se, table.background_se[..., None]], axis=-1)
    phi = np.repeat(table.phi[:, None], scene.fibers.count, axis=1)
    blocks = np.zeros(len(phi), dtype=int)
    return _grouped(
        scene, phi, table.bends, transport.swapaxes(0, 1), error.swapaxes(0, 1), blocks, None
    )


def cells_of_materials(scene: Scene, tables: Sequence[TransportTable], materials: Array) -> Cells:
    """Return the training cells of one reference table per material ``(material, quantity)``.

    The same cell of two materials is in one group: held out, it is unseen in all of them.

    Raises:
        TableError: as :func:`cells_from_table`, or when the tables' bends differ.
    """
    parts = [cells_from_table(scene, table) for table in tables]
    if any(not np.array_equal(part.bends, parts[0].bends) for part in parts):
        raise TableError(
            "the reference tables of the materials have different bends: render them together",
            field="bends",
        )
    blocks = np.repeat(np.arange(len(parts)), [len(part.phi) for part in parts])
    phi, transport, error = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("phi", "transport", "error")
    )
    return _grouped(scene, phi, parts[0].bends, transport, error, blocks, materials[blocks])


def _grouped(
    scene: Scene,
    phi: Array,
    bends: Array,
    transport: Array,
    error: Array,
    block: np.ndarray,
    material: Array | None,
) -> Cells:
    keys = _group_keys(scene, phi, bends)
    return Cells(
        phi=phi,
        bends=bends,
        transport=transport,
        error=error,
        group=_numbered(keys),
        fiber_group=_numbered(keys[..., :2]),
        direction_group=_numbered(keys[..., 2:3]),
        bend_group=_numbered(keys[..., 3:]),
        block=block,
        material=material,
    )


def _group_keys(scene: Scene, phi: Array, bends: Array) -> Array:
    """Return |x|, y, mirrored phi and bend of every group, ``(direction, fiber, bend, 4)``."""
    poses = flat_fiber_poses(scene)
    turns = (mirror_signs(scene) < 0) & (np.abs(poses.along[:, 0]) > 0.5)
    folded = np.where(turns, np.pi - phi, phi)
    shape = (*phi.shape, len(bends))
    columns = [
        np.broadcast_to(np.abs(poses.position[:, 0])[None, :, None], shape),
        np.broadcast_to(poses.position[:, 1][None, :, None], shape),
        np.broadcast_to(folded[..., None], shape),
        np.broadcast_to(bends, shape),
    ]
    return np.round(np.stack(columns, axis=-1), 6)


def _numbered(keys: Array) -> np.ndarray:
    """Return one integer per distinct row of ``keys`` ``(..., column)``."""
    _, index = np.unique(keys.reshape(-1, keys.shape[-1]), axis=0, return_inverse=True)
    return np.asarray(index).reshape(keys.shape[:-1])


def folds(group: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return the fold (0 .. count-1) of every entry; whole groups go to one fold, evenly."""
    groups = int(group.max()) + 1
    dealt = np.arange(groups) % count
    return np.asarray(np.random.default_rng(seed).permutation(dealt)[group])


def interior_folds(group: np.ndarray, count: int, seed: int, inner: bool) -> np.ndarray:
    """Return folds of whole groups; with ``inner`` the first and the last group stay in: fold -1.

    Groups are numbered in the order of their value, so that what ``inner`` holds out is always
    interpolation inside the trained range.
    """
    groups = int(group.max()) + 1
    chosen = np.arange(1, groups - 1) if inner else np.arange(groups)
    out = np.full(groups, -1)
    dealt = np.arange(len(chosen)) % max(1, min(count, len(chosen)))
    out[chosen] = np.random.default_rng(seed).permutation(dealt)
    return np.asarray(out[group])
