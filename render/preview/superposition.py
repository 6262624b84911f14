"""Direct light of any design at points: a table that is drawn once, superposed for each design.

Light is linear in what is emitted. Lamps that do not turn emit their power, one number each. A
diffuser's glow is a polynomial at each of its point lights, and nine numbers say it. Beams of lamps
that turn are not linear in their direction, and are drawn for each design.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from render.arrays import Array
from render.preview.lights import PointLights
from render.preview.passes import Points, ShaderPasses
from render.scene import Scene

MAX_TABLE = 2**24
"""Numbers of a table; the light of larger pictures is drawn for each design."""


@dataclass(frozen=True, eq=False)
class LightTable:
    """Direct light at some points at one bend.

    Arguments:
        passes: draw it.
        lights: of the scene.
        points: where.
        bend: rad.
        table: float32 ``(unit, point)``, light per unit of what `_amounts` returns, or None: then
            everything is drawn anew.
        rigid: whether units are lamps.
    """

    passes: ShaderPasses
    lights: PointLights
    points: Points
    bend: float
    table: NDArray[np.float32] | None
    rigid: bool

    def of(self, phi: Array, power: Array) -> NDArray[np.float32]:
        """Return irradiance ``(3, point)``, ``phi`` is ``(fiber,)``, ``power`` ``(fiber, 3)``."""
        if self.table is None:
            return self._drawn(*self.lights.merged(phi, power))
        if self.rigid:
            return np.asarray(power.T.astype(np.float32) @ self.table)
        light = self.lights.unit_amounts(phi, power).astype(np.float32) @ self.table
        rest = self.lights.not_in_units(phi, power)
        return np.asarray(light if rest is None else light + self._drawn(*rest))

    def _drawn(self, position: Array, emission: Array) -> NDArray[np.float32]:
        return self.passes.lists(position, emission, self.bend, self.points)


def light_table(
    scene: Scene, passes: ShaderPasses, lights: PointLights, points: Points, bend: float
) -> LightTable:
    """Draw the table of ``points`` at ``bend`` rad, if there is one and it is small enough."""
    table, rigid = None, not any(lamp.turns for lamp in scene.placed_lamps())
    if rigid and scene.lamp_count * points.count <= MAX_TABLE:
        straight = np.full((1, scene.lamp_count), np.pi / 2)
        emission = lights.emission(straight).swapaxes(0, 1)
        table = passes.direct(emission, bend, points)[:, 0, :, 0].copy()
    elif not rigid and lights.units is not None:
        position, emission = lights.units
        if len(emission) * points.count <= MAX_TABLE:
            table = passes.lists(position, emission, bend, points)
    return LightTable(passes, lights, points, bend, table, rigid)
