"""Skins that are not flat: what is read, what is refused, and that slopes are those of heights."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from render.scene import SHAPES, Scene, load_scene, scene_content, scene_of, unchecked
from tests.oracles.pads import SKINS, content_of_case, scene_of_case

CURVED = [(shape, scene_of_case(case)) for shape, case in SKINS.items()]


def changed(shape: str, **parts: Any) -> Scene:
    """Return the case of a shape with values changed: ``pad__thickness=(4.0, "mm")``."""
    content = content_of_case(SKINS[shape])
    for key, value in parts.items():
        part, _, name = key.partition("__")
        if isinstance(value, tuple):
            value = {"value": value[0], "unit": value[1], "source": "chosen for this test"}
        if name:
            content[part][name] = value
        else:
            content[part] = value
    return Scene.model_validate(content)


def refusal(shape: str, **parts: Any) -> str:
    with pytest.raises(ValidationError) as caught:
        changed(shape, **parts)
    return str(caught.value)


def test_every_shape_has_a_case() -> None:
    assert set(SKINS) == set(SHAPES)


@pytest.mark.parametrize(("shape", "scene"), CURVED)
def test_slopes_are_those_of_heights(shape: str, scene: Scene) -> None:
    assert scene.skin is not None
    x, y = scene.skin.grid(0.98 * scene.pad.width, 0.98 * scene.pad.length)
    step = 1e-4
    along_x, along_y = scene.skin.slope(x, y)
    rise = scene.skin.rise
    expected = (rise(x + step, y) - rise(x - step, y)) / (2 * step)
    np.testing.assert_allclose(np.broadcast_to(along_x, x.shape), expected, atol=1e-7)
    expected = (rise(x, y + step) - rise(x, y - step)) / (2 * step)
    np.testing.assert_allclose(np.broadcast_to(along_y, x.shape), expected, atol=1e-7)
    # The crown is in the middle, or between places.
    assert rise(x, y).max() == pytest.approx(0.0, abs=1e-3)
    assert rise(x, y).max() <= 1e-12


@pytest.mark.parametrize(("shape", "scene"), CURVED)
def test_a_skin_has_a_hash_of_its_own_and_travels_as_text(shape: str, scene: Scene) -> None:
    assert scene_of(scene_content(scene)) == scene
    flat = unchecked(scene, {"skin": None})
    assert scene.hash != flat.hash
    assert '"skin"' not in scene_content(load_scene("finger20"))


def test_a_dome_is_a_sphere() -> None:
    scene = scene_of_case("dome")
    assert scene.skin is not None
    x, y = scene.skin.grid(scene.pad.width, scene.pad.length)
    radius = scene.skin.radius
    assert radius == 30.0
    center = np.array([0.0, 0.0, -radius])
    points = np.stack([x, y, scene.skin.rise(x, y)], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(points - center, axis=-1), radius, atol=1e-12)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_an_arch_is_a_cylinder_about_its_axis(axis: str) -> None:
    scene = changed("arch", skin__axis=axis)
    assert scene.skin is not None
    x, y = scene.skin.grid(scene.pad.width, scene.pad.length)
    across = x if axis == "y" else y
    away = np.hypot(across, scene.skin.rise(x, y) + 20.0)
    np.testing.assert_allclose(away, 20.0, atol=1e-12)


def test_an_axis_is_that_of_an_arch_alone() -> None:
    assert "skin.axis: a dome has none, leave it out" in refusal("dome", skin__axis="x")
    content = content_of_case("arch")
    del content["skin"]["axis"]
    with pytest.raises(ValidationError, match=r"missing key skin\.axis"):
        Scene.model_validate(content)


def test_a_skin_needs_schema_2() -> None:
    assert "skin needs schema = 2" in refusal("dome", schema=1)


@pytest.mark.parametrize("shape", SHAPES)
def test_what_cannot_be_beside_a_curved_skin_raises_one_clear_error(shape: str) -> None:
    bent = refusal(shape, bending__angles=([0.0, 45.0], "deg"))
    assert f"bending.angles = 0, 45 deg: a skin of skin.shape = {shape} does not bend" in bent
    assert "allowed with one: 0" in bent
    rim = {"thickness": (2.0, "mm"), "sigma_s": (4.0, "1/mm"), "sigma_a": (0.0, "1/mm")}
    layer = {
        key: {"value": value, "unit": unit, "source": "chosen"}
        for key, (value, unit) in rim.items()
    }
    said = refusal(shape, diffuser=layer | {"g": {"value": 0.5, "source": "chosen"}})
    assert "diffuser: it lies on edges of even height" in said


def test_a_radius_that_is_missing_or_too_tight_raises_one_clear_error() -> None:
    content = content_of_case("dome")
    content["skin"] = {"shape": "dome"}
    with pytest.raises(ValidationError, match=r"missing key skin\.radius"):
        Scene.model_validate(content)
    said = refusal("dome", skin__radius=(9.15, "mm"))
    assert "skin.radius = 9.15 mm is too tight for a pad of 20 x 24 x 6 mm" in said
    least = float(said.partition("allowed: at least ")[2].partition(" mm")[0])
    lamps: dict[str, Any] = {"fibers__height": (0.05, "mm"), "fibers__tilt": (0.0, "deg")}
    assert changed("dome", skin__radius=(least, "mm"), **lamps).skin is not None
    assert "too tight" in refusal("dome", skin__radius=(least - 0.02, "mm"), **lamps)


def test_a_lamp_above_the_skin_raises_one_clear_error() -> None:
    # The sphere is 30 - sqrt(30^2 - 10^2) = 1.716 mm lower at the middle of the left edge.
    said = refusal("dome", fibers__height=(4.3, "mm"))
    assert (
        "fibers.left at z = 4.3 mm lies above the skin, which is 4.28 mm high at the left" in said
    )


def test_pyramids_that_leave_the_pad_raise_one_clear_error() -> None:
    said = refusal("dome", pad__thickness=(4.9, "mm"), indenter__slope=(80.0, "deg"))
    assert "the pyramid 3.93 mm deep" in said or "together at most" in said
    flat = {"radius": (1.6, "mm"), "slope": (1.0, "deg"), "faces": 6}
    probe = {
        name: {"value": value[0], "unit": value[1], "source": "chosen"}
        if isinstance(value, tuple)
        else value
        for name, value in flat.items()
    }
    said = refusal("dome", indenter=probe)
    assert "indenter.radius = 1.6 mm: around site 0 the skin curves" in said
