"""How many photons a scene gets for the light that no exit field has."""

from __future__ import annotations

import pytest

from render.preview.converged.transport import flight_cost
from render.scene import load_scene, unchecked
from tests.oracles.random_scenes import random_scene


def test_a_thin_layer_gets_nearly_as_many_photons_as_a_clear_pad() -> None:
    # 0.75 mm that scatter 0.41 times in a mm: two thirds of the light just pass.
    scene = random_scene(1)
    assert flight_cost(scene) == pytest.approx(1.31, abs=0.01)
    assert flight_cost(unchecked(scene, {"diffuser": None})) == 1.0


def test_photons_are_fewest_where_they_walk_for_long() -> None:
    assert flight_cost(load_scene("finger20")) == 3.0
