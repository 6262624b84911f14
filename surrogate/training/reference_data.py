"""What a model is fitted to: one reference table, or one per material of a free scene."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from render.arrays import Array
from render.progress import Progress
from render.scene.schema import Scene
from render.transport import TransportTable
from surrogate.model.materials import MaterialRange
from surrogate.training.dataset import Cells, cells_from_table, cells_of_materials

Report = Callable[..., None]
"""Called with a stage, parts done, parts in all and, where it is known, the rest in seconds."""


@dataclass(frozen=True, eq=False)
class Reference:
    """Reference tables with what is known of their rendering.

    Arguments:
        tables: the scene's own material first.
        renderer: settings, sample counts and seconds.
        materials: ``(material, quantity)`` of the tables, where the scene leaves it free.
    """

    tables: tuple[TransportTable, ...]
    renderer: dict[str, object]
    materials: Array | None = None

    def scaled(self, exposure: float, lam: float) -> Reference:
        """Return the reference with its exposure and lambda."""
        tables = tuple(replace(table, exposure=exposure, lam=lam) for table in self.tables)
        return replace(self, tables=tables)

    def save(self, run: Path) -> None:
        """Write ``reference.npz`` and, for other materials, ``reference-<number>.npz``."""
        self.tables[0].save(run / "reference.npz")
        for number, table in enumerate(self.tables[1:], start=1):
            table.save(run / f"reference-{number}.npz")

    def cells(self, scene: Scene) -> Cells:
        """Return the training cells."""
        if self.materials is None:
            return cells_from_table(scene, self.tables[0])
        return cells_of_materials(scene, self.tables, self.materials)

    @property
    def hash(self) -> str:
        """SHA-256 of the numbers, whatever files they are in."""
        if len(self.tables) == 1:
            return data_hash(self.tables[0])
        every = "".join(data_hash(table) for table in self.tables)
        return hashlib.sha256(every.encode()).hexdigest()


def render_reference(
    scene: Scene,
    run: Path,
    *,
    seed: int,
    minutes: float,
    samples: int | None,
    phi_count: int,
    bend_count: int,
    materials: Array | None,
    progress: Report,
) -> Reference:
    """Return the reference of ``scene``, rendered in the folder ``run``, going on where it stands.

    Arguments:
        scene: the sensor.
        run: where plans and renders are kept.
        seed: of the renders; every material has light paths of its own.
        minutes: rendering time of all materials together.
        samples: per cell and material instead.
        phi_count: nodes in phi.
        bend_count: nodes in the bend.
        materials: ``(material, quantity)``; None renders the scene's own alone.
        progress: see `Report`.
    """
    from surrogate.training.render_plan import estimate_table, make_plan, render_plan

    free = MaterialRange.of(scene)
    scenes, folders = [scene], [run]
    if free is not None and materials is not None:
        scenes = [free.scene_with(scene, material) for material in materials]
        folders = [run / f"material-{number}" for number in range(len(materials))]
    tables, seconds = [], 0.0
    settings: dict[str, object] = {}
    for number, (one, folder) in enumerate(zip(scenes, folders, strict=True)):
        progress("plan", number, len(scenes))
        plan = make_plan(
            one,
            folder,
            minutes=minutes / len(scenes),
            samples=samples,
            seed=seed + 100 * number,
            phi_count=phi_count,
            bend_count=bend_count,
        )
        title = "render" if len(scenes) == 1 else f"render material {number + 1} of {len(scenes)}"

        def told(state: Progress, title: str = title) -> None:
            progress(title, state.done, state.total, state.eta_seconds)

        estimate = render_plan(one, plan, folder, told)
        tables.append(estimate_table(one, plan, estimate))
        seconds += float(estimate.seconds)
        settings = settings or dict(estimate.settings)
    return Reference(tuple(tables), settings | {"seconds": seconds}, materials)


def data_hash(table: TransportTable) -> str:
    """Return the SHA-256 of the numbers in ``table``, whatever file they are in."""
    digest = hashlib.sha256(table.scene_hash.encode())
    for values in (table.phi, table.bends, table.T, table.se, table.background):
        if values is not None:
            digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
    return digest.hexdigest()
