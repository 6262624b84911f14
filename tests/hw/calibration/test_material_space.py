"""What is fitted of a rig is what its scene has and its light shows."""

from __future__ import annotations

import numpy as np
import pytest

from hw.calibration.material import material_space
from hw.errors import CalibrationError
from render.scene import Edge, Scene, load_scene, unchecked
from render.scene.faces import NamedFaces


def with_rough(scene: Scene, **roughness: float) -> Scene:
    """Return the scene with faces of other roughness."""
    faces = tuple(
        NamedFaces.model_construct(on=(face,), roughness=value) for face, value in roughness.items()
    )
    return unchecked(scene, {"faces": faces})


@pytest.mark.parametrize(
    ("name", "fitted"),
    [
        ("finger20", ("reduced_scattering", "absorption", "sigma_v", "roughness")),
        ("digit", ("albedo", "roughness")),
        ("gelsight-mini", ("albedo", "roughness")),
        # Its pad is as air: no face is rough, and nothing comes back from any.
        ("gelsight-flat", ("albedo",)),
    ],
)
def test_a_scene_is_asked_for_what_it_has(name: str, fitted: tuple[str, ...]) -> None:
    assert material_space(load_scene(name)).names == fitted


def test_a_clear_pad_with_fibers_has_their_beam_width_too() -> None:
    scene = unchecked(load_scene("finger20"), {"diffuser": None})
    assert material_space(scene).names == ("albedo", "roughness", "sigma_v")


@pytest.mark.parametrize("name", ["finger20", "digit", "gelsight-mini", "gelsight-flat"])
def test_a_material_goes_into_a_scene_and_out_again(name: str) -> None:
    scene = load_scene(name)
    space = material_space(scene)
    material = space.neutral
    own = space.put_into(scene, material)
    np.testing.assert_allclose(space.of(own), material)
    assert own.hash != scene.hash
    assert space.put_into(own, space.of(scene)).hash == scene.hash


def test_the_roughness_is_that_of_the_faces_that_lamps_shine_through() -> None:
    # Lamps before two edges; the window is smooth.
    scene = with_rough(load_scene("digit"), base=0.2, tip=0.2, lower=0.0)
    space = material_space(scene)
    np.testing.assert_allclose(space.values(space.of(scene)), [0.45, 0.2])
    rougher = space.put_into(scene, space.material(np.array([0.5, 0.3])))
    lit: tuple[Edge, ...] = ("base", "tip")
    np.testing.assert_allclose([rougher.finish(edge).roughness for edge in lit], 0.3)
    assert rougher.finish("lower").roughness == 0.0
    assert rougher.pad.roughness == scene.pad.roughness


def test_lit_faces_of_several_roughnesses_raise_one_clear_error() -> None:
    scene = with_rough(load_scene("digit"), base=0.2)
    with pytest.raises(CalibrationError, match=r"roughnesses 0\.2, 0\.1, allowed.* one"):
        material_space(scene)


def test_a_skin_with_a_lobe_on_a_clear_pad_raises_one_clear_error() -> None:
    lobe = {"specular": 0.2, "roughness": 0.3}
    glossy = unchecked(load_scene("digit").coating, lobe)
    with pytest.raises(CalibrationError, match=r"coating.specular = 0\.2, allowed for"):
        material_space(unchecked(load_scene("digit"), {"coating": glossy}))
    # Behind a diffuser the albedo is not fitted.
    scene = unchecked(load_scene("finger20"), {"coating": glossy})
    assert "albedo" not in material_space(scene).names


def test_a_curved_skin_and_rows_behind_a_diffuser_raise_one_clear_error() -> None:
    with pytest.raises(CalibrationError, match="curved skin"):
        material_space(load_scene("digit-dome"))
    milky = load_scene("finger20")
    rows = unchecked(milky, {"fibers": None, "rows": load_scene("digit").rows})
    with pytest.raises(CalibrationError, match="rows or lists"):
        material_space(rows)


@pytest.mark.parametrize("name", ["finger20", "digit"])
def test_slopes_of_the_polynomial_are_its_derivatives(name: str) -> None:
    space = material_space(load_scene(name))
    material = 0.4 * space.low + 0.6 * space.high
    step = 1e-5 * (space.high - space.low)
    for number, slope in enumerate(space.terms_slope(material)):
        away = step * (np.arange(len(step)) == number)
        there, back = space.terms(material + away), space.terms(material - away)
        np.testing.assert_allclose(slope, (there - back) / (2 * step[number]), atol=1e-7)


def test_more_quantities_need_more_materials() -> None:
    names = ("finger20", "digit", "gelsight-flat")
    assert [material_space(load_scene(name)).enough for name in names] == [32, 16, 8]


def test_materials_fill_the_range_of_a_clear_pad() -> None:
    space = material_space(load_scene("digit"))
    unit = (space.sobol(16) - space.low) / (space.high - space.low)
    assert ((unit >= 0) & (unit <= 1)).all()
    assert (unit.min(axis=0) < 0.1).all()
    assert (unit.max(axis=0) > 0.9).all()
