"""How many directions traced light of turning lamps has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from render.preview.converged import phi_nodes
from render.scene import Scene, load_scene
from tests.oracles.pads import content_of_case


def pad(sigma_v: float, **changes: Any) -> Scene:
    """Return a clear pad whose lamps have beams of a width (deg)."""
    content = content_of_case("smooth")
    content["fibers"]["sigma_v"]["value"] = sigma_v
    return Scene.model_validate(content | changes)


@pytest.mark.parametrize(("sigma_v", "least", "most"), [(60, 13, 13), (8, 25, 33), (3, 65, 99)])
def test_narrow_beams_have_more(sigma_v: float, least: int, most: int) -> None:
    nodes = phi_nodes(pad(sigma_v))
    assert least <= len(nodes) <= most
    assert np.diff(nodes).max() < max(np.radians(1.3 * sigma_v), 0.42)


def test_their_number_is_bounded() -> None:
    assert len(phi_nodes(pad(0.1))) == len(phi_nodes(pad(1.0))) == 129


def test_the_middle_one_is_straight_ahead() -> None:
    for sigma_v in (1.0, 4.0, 9.0, 14.0, 20.0):
        nodes = phi_nodes(pad(sigma_v))
        assert nodes[len(nodes) // 2] == pytest.approx(np.pi / 2, abs=1e-12)


def test_light_that_a_milky_layer_spreads_needs_few() -> None:
    assert len(phi_nodes(load_scene("finger20"))) == 13


def test_lamps_that_do_not_turn_need_few() -> None:
    assert len(phi_nodes(load_scene("gelsight-mini"))) == 13
