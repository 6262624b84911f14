"""Media in dielectrics under uniform light: what does not absorb cannot be seen.

Nothing absorbs here, so every pixel shows the radiance of the surroundings, except for what the
microfacet model itself loses: Walter's rough dielectric scatters once only.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import pytest

from tests.validation.film import (
    LONG,
    camera,
    check_same,
    check_truth,
    diffuse,
    gray,
    ours,
    relative_bar,
    theirs,
)

SPP = 65536 if LONG else 2048


def bath(mono: ModuleType, face: dict[str, Any], **parts: Any) -> Any:
    """Return a ball of white milk behind ``face`` in surroundings of radiance 1."""
    medium = {
        "type": "homogeneous", "albedo": 1.0, "sigma_t": 2.0, "phase": {"type": "hg", "g": 0.5},
    }  # fmt: skip
    return mono.load_dict(
        {
            "type": "scene",
            "surroundings": {
                "type": "sphere", "radius": 1.6, "flip_normals": True, "bsdf": diffuse(mono, 0.0),
                "emitter": {"type": "area", "radiance": gray(mono, 1.0)},
            },
            "ball": {"type": "sphere", "bsdf": face, "interior": medium},
            # It sees nothing but the ball.
            "sensor": camera(mono, [0, 0, -1.5], fov=60),
            **parts,
        }
    )  # fmt: skip


GLASS = {"type": "dielectric", "int_ior": 1.41, "ext_ior": 1.0}
KINDS = ["bdpt", "pssmlt"] if LONG else ["bdpt"]


@pytest.mark.parametrize("kind", KINDS)
def test_white_milk_without_a_boundary_is_invisible_in_uniform_light(
    mono: ModuleType, kind: str
) -> None:
    images = ours(mono, bath(mono, {"type": "null"}), kind, SPP)
    check_truth(images, 1.0, f"furnace, milk, {kind}", size=4)


@pytest.mark.parametrize("kind", KINDS)
def test_white_milk_in_smooth_glass_is_invisible_in_uniform_light(
    mono: ModuleType, kind: str
) -> None:
    images = ours(mono, bath(mono, GLASS), kind, SPP)
    check_truth(images, 1.0, f"furnace, milk in smooth glass, {kind}", size=4)


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_behind_a_rough_face_only_the_models_own_loss_is_missing(
    mono: ModuleType, distribution: str
) -> None:
    rough = {"type": "roughdielectric", "distribution": distribution, "alpha": 0.1}
    scene = bath(mono, GLASS | rough)
    images, unidirectional = ours(mono, scene, "bdpt", SPP), theirs(mono, scene, "volpath", 256)
    check_same(images, unidirectional, f"furnace, milk behind {distribution} faces", size=8)
    # Everything that volpath meets has radiance 1: its mean is the model's own loss.
    print(f"{distribution}: {unidirectional.mean():.4f} +- {relative_bar(unidirectional):.4f}")
    assert 0.9 < unidirectional.mean() < 1.001
