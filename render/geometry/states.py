"""States of a skin: the sensor that stays in one of them, and the chart that follows the material.

A point of the skin keeps its ``uv``, its x and y at rest, wherever a state moves it. A pyramid is
rigid, stands on the skin at its site and turns with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from render.arrays import Array
from render.geometry.chart import SkinChart
from render.geometry.layout import turned_about_normal
from render.geometry.seen_sites import camera_coverage, counted_sites
from render.scene import CarriedSites, Scene, State, unchecked


@lru_cache(maxsize=64)
def in_state(scene: Scene, value: float) -> tuple[Scene, float]:
    """Return the sensor that stays in one state, and its bend in rad.

    That is the scene itself and ``value`` where its states are bends. Else ``value`` is the number
    of a state, the sensor has that skin alone, and its sites are where the skin carries them; those
    count that count in all states.

    Raises:
        SceneError: there is no such state, or no site that counts in all of them.
    """
    if scene.states is None:
        return scene, value
    one, counted = scene.in_state(value), counted_sites(scene)
    if np.array_equal(camera_coverage(one).counted, counted):
        return one, 0.0
    (x, y), turn = one.sites.places.T.tolist(), one.sites.turns.tolist()
    carried = CarriedSites.model_construct(
        x=tuple(x), y=tuple(y), turn=tuple(turn), counted=tuple(counted.tolist())
    )
    sites = unchecked(one.sites, {"carried": carried})
    return unchecked(one, {"sites": sites}), 0.0


@dataclass(frozen=True)
class StateChart:
    """The skin of a scene in the state ``number``, by the coordinates ``uv`` that it has at rest.

    The same as `SkinChart` where states are bends, ``number`` being one in rad.
    """

    scene: Scene
    number: float

    def points(self, uv: Array) -> Array:
        """Return world positions ``(..., 3)`` mm of points ``uv`` ``(..., 2)``."""
        chart, state = self._of_state
        return chart.points(uv if state is None else state.places(uv))

    def frames(self, uv: Array) -> Array:
        """Return rotations ``(..., 3, 3)`` from the skin's frames, which turn with the material."""
        chart, state = self._of_state
        if state is None:
            return chart.frames(uv)
        return turned_about_normal(chart.frames(state.places(uv)), state.turns(uv))

    def uv(self, world: Array) -> Array:
        """Return the coordinates ``(..., 2)`` at rest of world points ``(..., 3)`` on the skin."""
        chart, state = self._of_state
        places = chart.uv(world)
        return places if state is None else state.rest_places(places)

    @property
    def _of_state(self) -> tuple[SkinChart, State | None]:
        """The chart of the skin as it is, and what moves it; None at rest."""
        if self.scene.states is None:
            return SkinChart(self.scene, self.number), None
        chart = SkinChart(self.scene.in_state(self.number), 0.0)
        return chart, self.scene.states[int(self.number) - 1] if self.number else None
