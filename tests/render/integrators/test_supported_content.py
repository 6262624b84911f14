"""The gate for Mitsuba scenes refuses what is not on its list, before anything is traced."""

from __future__ import annotations

import subprocess
import sys
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

from render.errors import RenderError
from tests.validation.gallery import bsdfs, view


def rendered(mono: ModuleType, scene: Any, **integrator: Any) -> Any:
    return mono.render(scene, integrator=mono.load_dict({"type": "bdpt"} | integrator), spp=1)


def floor_of(mono: ModuleType, bsdf: dict[str, Any]) -> Any:
    return view(mono, {}, {}, floor={"type": "rectangle", "bsdf": bsdf})


VELVET = """
import sys
from render.reference.llvm import mitsuba
mi = mitsuba("llvm_ad_mono")
from render.errors import RenderError
from tests.render.integrators.test_supported_content import floor_of, rendered

class Velvet(mi.BSDF):
    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.m_flags = mi.BSDFFlags.DiffuseReflection

    def to_string(self):
        return "Velvet[]"

mi.register_bsdf("velvet", Velvet)
for bsdf in ({"type": "velvet"}, {"type": "mask", "a": {"type": "velvet"}}):
    try:
        rendered(mi, floor_of(mi, bsdf))
    except RenderError as error:
        print(error)
"""


def test_a_plugin_written_in_python_is_refused_by_the_name_of_its_class() -> None:
    """In a process of its own: Dr.Jit calls the methods of all instances that are alive."""
    done = subprocess.run([sys.executable, "-c", VELVET], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    for said in (first, second):
        assert "shape 'floor' has a Velvet" in said
        assert "allowed: diffuse" in said


@pytest.mark.parametrize(
    ("kind", "plugin", "name"),
    [
        ("bsdf", "roughplastic", "nonlinear"), ("bsdf", "roughplastic", "diffuse_reflectance"),
        ("film", "hdrfilm", "component_format"), ("sensor", "perspective", "near_clip"),
        ("emitter", "area", "radiance"), ("shape", "sphere", "to_world"),
        ("rfilter", "box", None), ("sampler", "independent", None),
    ],
)  # fmt: skip
def test_what_the_list_does_not_know_of_a_scene_is_refused_and_not_ignored(
    mono: ModuleType, monkeypatch: pytest.MonkeyPatch, kind: str, plugin: str, name: str | None
) -> None:
    from render.integrators.supported_plugins import PLUGINS

    known, names = PLUGINS[kind][plugin]
    left = " ".join(other for other in names.split() if other != name)
    # As if a later Mitsuba had brought the parameter, or the plugin.
    monkeypatch.setitem(PLUGINS[kind], plugin, (known if name else "Older", left))
    with pytest.raises(RenderError, match=f"the parameter '{name}'" if name else known) as caught:
        rendered(mono, view(mono, {}, {}))
    assert caught.value.field == (name or kind)


def test_a_texture_in_any_slot_of_any_bsdf_is_taken(mono: ModuleType) -> None:
    from render.integrators.supported_content import refuse_unsupported

    slots = 0
    for bsdf in bsdfs(mono).values():
        shown = mono.traverse(mono.load_dict(bsdf)).keys()
        names = {key.partition(".")[0] for key in shown if key.endswith(".value")}
        for name in names - {"bsdf_0", "bsdf_1", "brdf_0", "brdf_1", "nested_bsdf"}:
            scene = floor_of(mono, bsdf | {name: {"type": "checkerboard"}})
            refuse_unsupported(scene, scene.sensors()[0])
            slots += 1
    assert slots > 30


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ({"hide_emitters": True}, "hide_emitters = True"), ({"timeout": 2.0}, "timeout = 2"),
        ({"max_depth": 3.5}, "of type float, allowed: int"),
        ({"error_bars": "false"}, "of type str, allowed: bool"),
        ({"inner": {"type": "path"}}, "inner = PathIntegrator"),
    ],
)  # fmt: skip
def test_an_option_that_is_not_known_or_of_another_type_is_named(
    mono: ModuleType, option: dict[str, Any], says: str
) -> None:
    with pytest.raises(RenderError, match=says):
        rendered(mono, view(mono, {}, {}), **option)


def test_integrators_around_ours_are_told_that_it_renders_whole_pictures(mono: ModuleType) -> None:
    outer = mono.load_dict({"type": "moment", "a": {"type": "bdpt"}})
    with pytest.raises(RenderError, match="bdpt is inside of another integrator"):
        mono.render(view(mono, {}, {}), integrator=outer, spp=1)


def test_gradients_are_refused_with_the_parameter_that_asks_for_them(mono: ModuleType) -> None:
    scene = view(mono, {}, {})
    parameters = mono.traverse(scene)
    dr.enable_grad(parameters["floor.bsdf.reflectance.value"])
    parameters.update()
    integrator = mono.load_dict({"type": "bdpt"})
    for render in (
        lambda: mono.render(scene, parameters, integrator=integrator),
        lambda: mono.render(scene, integrator=integrator),
        lambda: integrator.render(scene),
        lambda: integrator.render_forward(scene, parameters),
    ):
        with pytest.raises(RenderError, match=r"gradients"):
            render()


@pytest.mark.parametrize("variant", ["scalar_rgb", "llvm_ad_spectral", "llvm_ad_mono_polarized"])
def test_another_variant_is_refused_by_name(variant: str) -> None:
    code = f"""
import mitsuba as mi
mi.set_variant("{variant}")
import render
render.register_plugins()
scene = mi.load_dict(mi.cornell_box())
for outer in ({{"type": "bdpt"}}, {{"type": "moment", "a": {{"type": "pssmlt"}}}}):
    try:
        mi.render(scene, integrator=mi.load_dict(outer), spp=1)
    except render.errors.RenderError as error:
        print(error)
"""
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert f"variant {variant} is not supported, allowed: llvm_ad_mono" in said.stdout
    assert "pssmlt is inside of another integrator" in said.stdout


def test_a_telephoto_camera_far_from_the_origin_is_taken(mono: ModuleType) -> None:
    """Rounding of its origin moves what it sees by more than a thousandth of the picture."""
    to_world = mono.ScalarTransform4f().look_at(
        origin=[3000, 2000, 9000], target=[0, 0, 0], up=[0, 1, 0]
    )
    lens = {"to_world": to_world, "fov": 0.012, "near_clip": 100.0, "far_clip": 20000.0}
    scene = view(mono, lens, {})
    picture = rendered(mono, scene, max_depth=4)
    assert np.isfinite(np.array(picture)).all()
    assert np.array(picture).mean() > 0.1


def test_parameters_of_another_kind_are_refused_as_mitsuba_refuses_them(mono: ModuleType) -> None:
    for given in (mono.Float([1.0, 2.0]), mono.TensorXf(np.ones((2, 2))), np.ones(2), {"a": 1.0}):
        with pytest.raises(Exception, match="should be an instance of"):
            mono.render(view(mono, {}, {}), given, integrator=mono.load_dict({"type": "bdpt"}))
