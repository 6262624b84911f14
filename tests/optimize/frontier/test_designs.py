"""Held-out designs and the nodes that render all of them."""

from __future__ import annotations

import numpy as np
import pytest

from optimize.frontier.designs import held_out_designs, shared_nodes
from render.geometry.symmetry import mirrors
from render.scene.schema import Scene


def variant(scene: Scene, **counts: int) -> Scene:
    return scene.model_copy(update={"fibers": scene.fibers.model_copy(update=counts)})


def test_the_same_seed_gives_the_same_designs_and_another_one_others(finger20: Scene) -> None:
    first, again, other = (held_out_designs(finger20, 5, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.phi, again.phi)
    np.testing.assert_array_equal(first.power, again.power)
    assert (first.phi != other.phi).all()


def test_every_fiber_of_a_design_has_one_color(finger20: Scene) -> None:
    designs = held_out_designs(finger20, 30, 0)
    assert len(designs) == 30
    assert ((designs.phi >= 0) & (designs.phi <= np.pi)).all()
    assert (designs.power.sum(axis=-1) == 1).all()
    assert set(np.unique(designs.power)) == {0.0, 1.0}


@pytest.mark.parametrize("tip", [0, 3, 4])
def test_shared_nodes_hold_every_design_and_its_mirror_image(finger20: Scene, tip: int) -> None:
    scene = variant(finger20, tip=tip)
    designs = held_out_designs(scene, 7, 0)
    nodes = shared_nodes(scene, designs)
    assert nodes.phi.shape == (scene.fibers.count, 14)
    assert mirrors(scene, nodes.phi)
    np.testing.assert_array_equal(nodes.of_designs(nodes.phi), designs.phi)


def test_a_sensor_without_mirror_images_gets_its_designs_alone(finger20: Scene) -> None:
    scene = variant(finger20, left=7)
    designs = held_out_designs(scene, 4, 0)
    nodes = shared_nodes(scene, designs)
    assert nodes.phi.shape == (scene.fibers.count, 4)
    np.testing.assert_array_equal(nodes.of_designs(nodes.phi), designs.phi)
