"""Every value of a scene at both ends of its range: finite light, or one clear refusal."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

import render.preview.lights
from render.errors import RenderError, SceneError
from render.preview import Preview
from render.scene import Count, Quantity, Scene

Range = Quantity | Count
PHI, BENDS = np.array([0.0, math.pi / 2, math.pi]), np.array([0.0, math.pi])
# What must change along with a value, so that its end is a possible sensor at all.
ALONG: dict[tuple[str, str], dict[str, Any]] = {
    ("pad.thickness", "low"): {"fibers.height": 0.005, "indenter.radius": 0.05,
                               "indenter.slope": 1.0, "fibers.diameter": 0.05},
    ("fibers.gap", "low"): {"fibers.diameter": 0.05},
    ("fibers.diameter", "high"): {"fibers.gap": 10.0, "pad.thickness": 10.0},
    ("fibers.height", "high"): {"pad.thickness": 200.0},
    ("fibers.left", "high"): {"pad.length": 60.0},
    ("fibers.right", "high"): {"pad.length": 60.0},
    ("fibers.tip", "high"): {"pad.width": 60.0},
    ("indenter.radius", "high"): {"pad.thickness": 20.0, "pad.width": 100.0, "pad.length": 100.0},
    ("sites.columns", "high"): {"pad.width": 200.0},
    ("sites.rows", "high"): {"pad.length": 500.0},
}  # fmt: skip
# Ends at which no sensor is possible, whatever else changes.
IMPOSSIBLE = {
    ("pad.width", "low"), ("pad.length", "low"),
    *((f"sites.centre_{axis}", end) for axis in "xy" for end in ("low", "high")),
    ("camera.field_of_view", "high"), ("window.thickness", "high"),
}  # fmt: skip
# Too little light comes through, or hits so thin an edge, to say anything.
OPAQUE = {
    ("diffuser.thickness", "high"), ("diffuser.sigma_a", "high"), ("pad.thickness", "low"),
}  # fmt: skip
# The camera has no pixel for every facet of the site.
UNSEEN = {
    ("pad.thickness", "high"), ("fibers.height", "high"), ("camera.rows", "low"),
    ("indenter.faces", "high"), ("indenter.radius", "low"),
}  # fmt: skip
BLACK = {("coating.albedo", "low")}


def ranges() -> Iterator[tuple[str, Range]]:
    """Yield every physical value of a scene file with its range."""
    for part, field in Scene.model_fields.items():
        # What a builder may choose lights nothing by itself.
        if part in ("constraints", "tolerances"):
            continue
        for kind in (field.annotation, *getattr(field.annotation, "__args__", ())):
            for name, value in getattr(kind, "model_fields", {}).items():
                yield from (
                    (f"{part}.{name}", note)
                    for note in value.metadata
                    if isinstance(note, Quantity | Count)
                )


RANGES = dict(ranges())


def content(**changes: float) -> dict[str, Any]:
    """Return finger20 with three fibers, one site and four facets, and some values replaced."""
    text = (resources.files("render") / "scenes" / "finger20.toml").read_text()
    found = tomllib.loads(text)
    found["fibers"] |= {"left": 1, "tip": 1, "right": 1}
    found["sites"] |= {"columns": 1, "rows": 1}
    found["indenter"] |= {"faces": 4}
    if any(key.startswith("window.") for key in changes):
        # A clear, flat pad on a window of its own index.
        del found["diffuser"]
        found["schema"] = 2
        found["bending"]["angles"]["value"] = [0.0]
        found["window"] = {
            "thickness": {"value": 1.0, "unit": "mm", "source": "assumed"},
            "index": found["pad"]["index"],
        }
    for key, value in changes.items():
        part, name = key.split(".")
        if isinstance(RANGES[key], Count):
            found[part][name] = int(value)
        else:
            many = getattr(RANGES[key], "many", False)
            found[part][name] = {**found[part][name], "value": [value] if many else value}
    return found


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(render.preview.lights, "RAYS", 600)
        yield tmp_path_factory.mktemp("slab")


def test_the_matrix_holds_every_value_of_a_scene() -> None:
    assert len(RANGES) >= 30
    assert {key for key, _ in ALONG} | {key for key, _ in IMPOSSIBLE} <= set(RANGES)


@pytest.mark.slow
@pytest.mark.parametrize("key", RANGES)
@pytest.mark.parametrize("end", ["low", "high"])
def test_at_the_ends_of_its_range_light_is_finite_and_positive(
    key: str, end: str, cache: Path
) -> None:
    value = float(getattr(RANGES[key], end))
    changed = content(**{**ALONG.get((key, end), {}), key: value})
    if (key, end) in IMPOSSIBLE:
        with pytest.raises(ValidationError, match="allowed"):
            Scene.model_validate(changed)
        return
    scene = Scene.model_validate(changed)
    if (key, end) in OPAQUE:
        with pytest.raises(RenderError, match="the diffuser lets only"):
            Preview(scene, cache=cache)
        return
    if (key, end) in UNSEEN:
        with pytest.raises(SceneError, match="the camera sees none of 1 sites whole"):
            Preview(scene, cache=cache)
        return
    with Preview(scene, cache=cache) as preview:
        for values in preview.transport(PHI, BENDS):
            assert np.isfinite(values).all()
            if (key, end) in BLACK:
                assert (values == 0).all()
            else:
                # Facets may lie in full shadow; no light comes out below zero.
                assert (values >= 0).all()
                assert values.max() > 0


@pytest.mark.parametrize("key", RANGES)
def test_a_step_beyond_its_range_is_refused_with_the_range(key: str) -> None:
    allowed = RANGES[key]
    step = 1.0 if isinstance(allowed, Count) else 1e-3 * max(1.0, abs(allowed.high))
    for value in (allowed.low - step, allowed.high + step):
        with pytest.raises(ValidationError, match=r"allowed: .* to"):
            Scene.model_validate(content(**{key: value}))


@pytest.mark.parametrize("edge", ["left", "tip", "right"])
def test_a_single_fiber_lights_the_pad(edge: str, cache: Path) -> None:
    changed = content()
    changed["fibers"] |= {name: int(name == edge) for name in ("left", "tip", "right")}
    with Preview(Scene.model_validate(changed), cache=cache) as preview:
        facets, background = preview.transport(PHI, BENDS)
    assert facets.shape[0] == background.shape[0] == 1
    assert (background > 0).all()
