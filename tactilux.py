"""Design the lighting of vision-based tactile sensors: the public API of tactilux.

Everything that programs and notebooks may rely on is here; what lies inside the packages may move.
Lengths in mm, angles in rad, powers as fractions of full power. Arrays are float64 numpy arrays;
transport has the axes ``(fiber, phi_node, bend, site, facet)``, radiance at the camera in
1/(mm^2 sr) per unit power of one fiber. Wrong input raises a `TactiluxError` that names the field,
the value and what is allowed.

>>> import numpy as np, tactilux
>>> scene = tactilux.load_scene("finger20")
>>> scene.lamp_count, scene.sites.count, scene.indenter.faces
(20, 15, 10)
>>> baseline = tactilux.baseline_design(scene)
>>> baseline.color_names[:2], float(np.degrees(baseline.phi[0]))
(['red', 'red'], 90.0)
>>> checker = tactilux.load_model(scene)
>>> bends = np.array(scene.state_axis)  # rad, or numbers of states
>>> said = checker.run(baseline.phi[None], baseline.power[None], bends)
>>> said["counts"].shape  # (design, bend, site, facet, channel)
(1, 3, 15, 10, 3)
>>> round(float(said["score"][0]))
234

The preview (level 0), the surrogate (`Checker`, level 1) and the reference (`render_transport`,
level 2) predict the same array::

    with tactilux.Preview(scene) as preview:
        T, background = preview.transport(baseline.phi[:, None], bends)
    rendered = tactilux.render_transport(scene, baseline.phi[:, None], bends, samples=64)
    rendered.T, rendered.se, rendered.background, rendered.background_se

A design is searched, and proven, in two lines::

    found = tactilux.explore(scene)
    proof = tactilux.verify(found.design, scene)

Importing this module loads nothing; every name loads what it needs when it is first used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from optimize.design import Design, baseline_design, load_design, save_design
    from optimize.exploration import Exploration
    from optimize.search import SearchStep
    from optimize.verification import Optimization, OptimizationMethod, Verification
    from render import register_plugins
    from render.errors import (
        CompilerError,
        DesignError,
        GraphicsError,
        ModelError,
        ReadError,
        RenderError,
        SceneError,
        TableError,
        TactiluxError,
    )
    from render.preview import Preview
    from render.progress import OnProgress
    from render.reference import render_transport
    from render.scene import Scene, load_scene
    from render.transport import TransportTable, load_table
    from surrogate.runtime import Checker

_HOMES = {
    "Scene": "render.scene",
    "load_scene": "render.scene",
    "Preview": "render.preview",
    "render_transport": "render.reference",
    "TransportTable": "render.transport",
    "load_table": "render.transport",
    "register_plugins": "render",
    "Checker": "surrogate.runtime",
    "Design": "optimize.design.design",
    "baseline_design": "optimize.design.design",
    "load_design": "optimize.design.design_file",
    "save_design": "optimize.design.design_file",
    "TactiluxError": "render.errors",
    "SceneError": "render.errors",
    "DesignError": "render.errors",
    "TableError": "render.errors",
    "ModelError": "render.errors",
    "ReadError": "render.errors",
    "GraphicsError": "render.errors",
    "CompilerError": "render.errors",
    "RenderError": "render.errors",
}
"""Where each name lives that this module hands on."""

__all__ = [
    "Checker",
    "CompilerError",
    "Design",
    "DesignError",
    "GraphicsError",
    "ModelError",
    "Preview",
    "ReadError",
    "RenderError",
    "Scene",
    "SceneError",
    "TableError",
    "TactiluxError",
    "TransportTable",
    "baseline_design",
    "explore",
    "load_design",
    "load_model",
    "load_scene",
    "load_table",
    "optimize",
    "register_plugins",
    "render_transport",
    "save_design",
    "verify",
]


def __getattr__(name: str) -> Any:
    """Return a name of another module, loaded when it is first asked for (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'tactilux' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)


def load_model(scene: Scene, folder: str | Path | None = None) -> Checker:
    """Return the surrogate of ``scene``, level 1, or its preview, level 0, where there is none.

    The first time that takes about a minute: the converged preview follows light to every facet.

    Arguments:
        scene: the sensor.
        folder: that holds ``checker.onnx`` (default: found by the scene's hash, here
            or as shipped).

    Raises:
        ModelError: there is none in ``folder``, or it is altered, corrupt or of another scene.
    """
    from optimize.scoring import open_model

    return open_model(scene, None if folder is None else Path(folder))


def explore(
    scene: Scene,
    *,
    model: Checker | None = None,
    seed: int = 0,
    progress: Callable[[SearchStep], None] | None = None,
) -> Exploration:
    """Return a better design for ``scene``, searched and rated on the surrogate in seconds.

    Arguments:
        scene: the sensor; the search keeps to its constraints.
        model: its surrogate (default: `load_model`).
        seed: of the search; the same seed gives the same design.
        progress: called after every step of the search.

    Returns:
        ``design``, its ``rating`` (score S of thesis eq. 4.7 in counts with a 90 % interval), and
        ``stages`` from the baseline on.
    """
    from optimize.exploration import explore as run

    return run(scene, model or load_model(scene), seed=seed, progress=progress)


def verify(
    design: Design,
    scene: Scene,
    *,
    model: Checker | None = None,
    samples: int = 200,
    seeds: Sequence[int] = (1, 2, 3, 4),
    checkpoint: str | Path | None = None,
    progress: OnProgress | None = None,
) -> Verification:
    """Return what renders say about ``design`` against the baseline, at level 2.

    Arguments:
        design: what is verified.
        scene: its sensor.
        model: the surrogate whose prediction is checked; exposure and lambda are its own.
        samples: light paths per (fiber, facet) pair and seed.
        seeds: common to both designs.
        checkpoint: a folder; interrupted, the same call goes on from there and ends bit-equal.
        progress: called every few seconds with what is rendered.

    Returns:
        ``baseline`` and ``design`` (scores with standard errors, counts), their ``difference``
        with an interval, and ``conclusion``, one sentence.
    """
    from optimize.exploration import rate
    from optimize.verification import verify as run

    checker = model or load_model(scene)
    return run(
        rate(checker, scene, "design", "Design", "", design),
        checker,
        samples=samples,
        seeds=seeds,
        checkpoint=None if checkpoint is None else Path(checkpoint),
        progress=progress,
    )


def optimize(
    scene: Scene,
    *,
    model: Checker | None = None,
    method: OptimizationMethod = "loop",
    samples: int = 96,
    seed: int = 0,
    checkpoint: str | Path | None = None,
    progress: OnProgress | None = None,
) -> Optimization:
    """Return a design that renders chose: the surrogate proposes, level 2 decides.

    Arguments:
        scene: the sensor.
        model: its surrogate (default: `load_model`).
        method: the verification ``loop``, the ``thesis`` procedure, or ``both`` side by side.
        samples: light paths per (fiber, facet) pair of every candidate's render.
        seed: of searches and renders.
        checkpoint: a folder; interrupted, the same call goes on from there.
        progress: called every few seconds with what is rendered.
    """
    from optimize.verification import OptimizeConfig, reference_renders
    from optimize.verification import optimize as run

    folder = None if checkpoint is None else Path(checkpoint)
    render = reference_renders(scene, folder, progress)
    config = OptimizeConfig(method=method, samples=samples, seed=seed)
    return run(scene, model or load_model(scene), render, config)
