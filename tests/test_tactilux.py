"""The public API: what may be imported, and what importing it costs."""

from __future__ import annotations

import inspect
import subprocess
import sys

import numpy as np
import pytest

import tactilux

HEAVY = ("numpy", "torch", "mitsuba", "drjit", "cma", "numba", "matplotlib", "onnxruntime")


def test_every_public_name_is_there_and_documented() -> None:
    for name in tactilux.__all__:
        assert getattr(tactilux, name).__doc__, name
    assert set(tactilux.__all__) <= set(dir(tactilux))


def test_a_name_that_does_not_exist_raises_the_usual_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'Sensor'"):
        tactilux.Sensor  # noqa: B018


def test_importing_it_loads_none_of_the_large_packages() -> None:
    code = (
        f"import json, sys, tactilux; print(json.dumps([m for m in {HEAVY} if m in sys.modules]))"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_all_errors_are_one_family() -> None:
    errors = [getattr(tactilux, name) for name in tactilux.__all__ if name.endswith("Error")]
    assert len(errors) == 9
    assert all(issubclass(error, tactilux.TactiluxError) for error in errors)


def test_the_three_levels_predict_the_same_array() -> None:
    scene = tactilux.load_scene("finger20")
    phi, bends = np.array([np.pi / 2]), np.array([0.0])
    with tactilux.Preview(scene) as preview:
        drawn, drawn_background = preview.transport(phi, bends)
    modeled = tactilux.load_model(scene).transport_table(phi, bends)
    rendered = tactilux.render_transport(scene, phi, bends, samples=32)
    assert drawn.shape == modeled.T.shape == rendered.T.shape
    assert drawn_background.shape == rendered.background.shape
    for level in (drawn, modeled.T):
        z = (level - rendered.T) / np.hypot(rendered.se, 0.05 * rendered.T)
        assert np.abs(np.median(z)) < 0.5
        assert np.median(np.abs(z)) < 1.5


def test_render_transport_takes_and_hands_on_what_the_reference_takes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import render.reference

    own = inspect.signature(render.reference.render_transport).parameters
    public = inspect.signature(tactilux.render_transport).parameters
    for name, one in public.items():
        told = str(one.annotation).replace(" | bool", "")  # a bar, which `render` cannot draw
        assert (one.kind, one.default, told) == (own[name].kind, own[name].default,
                                                 own[name].annotation)  # fmt: skip
    handed: dict[str, object] = {}

    def record(*first: object, **rest: object) -> None:
        handed.update(zip(own, first, strict=False), **rest)

    monkeypatch.setattr(render.reference, "render_transport", record)
    given = {name: object() for name in public if name != "progress"}
    tactilux.render_transport(**given)  # type: ignore[arg-type]
    assert handed == {**given, "progress": None}


@pytest.mark.slow
def test_a_search_is_proven_by_renders() -> None:
    scene = tactilux.load_scene("finger20")
    checker = tactilux.load_model(scene)
    baseline = tactilux.baseline_design(scene)
    colors = (baseline.colors + 1) % 3
    renamed = tactilux.Design.of_colors(baseline.phi, colors)
    # Exchanging the colors changes no score, so this is a tie by construction.
    proof = tactilux.verify(renamed, scene, model=checker, samples=16, seeds=(1, 2))
    assert proof.difference.value == pytest.approx(0.0, abs=1e-9)
    # So few samples decide nothing else either.
    assert proof.conclusion.startswith(("A tie in S", "The renders have not converged"))
