"""What every report is put together with: templates, warnings, pictures inside the file."""

from __future__ import annotations

import base64
import shlex
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from optimize.design import CLIPPED, Design
from optimize.readers import guessing_error
from render.describe import one_hue_advice
from render.geometry import FiberHolder
from render.levels import FEW_PATHS, PREVIEW
from render.preview.converged import narrowest_turning_beam
from render.preview.converged.color_noise import NOISE_LIMIT
from render.scene import Scene
from render.sensor_drawing import sensor_svg

GUESSING = 0.5
"""Part of the error of a guess from which on a reader hardly reads."""
NARROW_BEAM = np.radians(2.0)
"""Beams of lamps that turn, below which previews are less sure than their intervals say."""


def render_page(template: str, context: Mapping[str, Any], package: str = "optimize") -> str:
    """Return the HTML of a template in a package's ``templates``; what it lacks is an error."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(package, "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(context)


def template_text(name: str) -> str:
    """Return the text of a file beside the templates, as it is."""
    return (resources.files("optimize") / "templates" / name).read_text(encoding="utf-8")


def picture_kind(content: bytes) -> str:
    """Return the ending of the file that a picture is: ``svg`` or ``png``."""
    return "svg" if content.startswith(b"<svg") else "png"


def data_uri(content: bytes) -> str:
    """Return a picture as a link that holds it."""
    kind = {"svg": "svg+xml", "png": "png"}[picture_kind(content)]
    return f"data:image/{kind};base64," + base64.b64encode(content).decode("ascii")


def sensor_figure(scene: Scene) -> str:
    """Return the drawing of the sensor as a link that holds it."""
    return data_uri(sensor_svg(scene, dark=True).encode())


def stage_pictures(pictures: Mapping[str, bytes], key: str) -> dict[str, str]:
    """Return scheme, heat maps and facets of a design, from ``<kind>-<key>`` in ``pictures``."""
    kinds = ("scheme", "metric", "degrees", "facets")
    known = {kind: pictures[f"{kind}-{key}"] for kind in kinds if f"{kind}-{key}" in pictures}
    return {kind: data_uri(content) for kind, content in known.items()}


Steps = list[tuple[str, str]]
"""What to do next: why, and the command."""


def verification_steps(design: Path, scene: str, effort: str | None) -> Steps:
    """Return what to do with a ``design`` that nobody has rendered, before it is built.

    ``scene`` is what commands take: a shipped name, or a file; ``effort`` is that of its rating.
    """
    steps = [
        (
            "Let renders decide whether it is better than the baseline:",
            f"tactilux verify {_word(design)}",
        )
    ]
    if effort in (None, FEW_PATHS):
        steps.append(("For more than a few designs, train a model of this sensor:",
                      f"tactilux train {_word(scene)}"))  # fmt: skip
    return steps


def depth_steps(scene: Scene, design: Path) -> Steps:
    """Return how to learn what depth a ``design`` reads; nothing where the skin is not flat."""
    if scene.skin is not None or scene.states is not None:
        return []
    return [
        ("See how exactly it reads the depth of a ball, in micrometers:",
         f"tactilux reconstruct {_word(design)} --press ball")
    ]  # fmt: skip


def building_steps(design: Path, scene: str) -> Steps:
    """Return what to do with a ``design`` that is to be built; see `verification_steps`."""
    return [
        ("See which tolerance costs the most:", f"tactilux sensitivity {_word(design)}"),
        ("Order and build; for other steps of the angles and other numbers of the LEDs:",
         f"tactilux wiring {_word(design)}"),
        ("Light the built sensor:", f"tactilux hw set {_word(design)}"),
        ("Record it while it is healthy, for the check at every start:",
         f"tactilux check {_word(scene)} --design {_word(design)} --capture SWEEP "
         "--commission rig.npz"),
    ]  # fmt: skip


def built_steps(design: Path) -> Steps:
    """Return what to do with a ``design`` whose lamps sit at new places."""
    return [
        ("Write the scene file of the sensor that this is, with its lit lamps alone:",
         f"tactilux build {_word(design)} --out mine.toml"),
    ]  # fmt: skip


def _word(path: str | Path) -> str:
    """Return a path as a shell reads it."""
    return shlex.quote(str(path))


def monochrome_warning(design: Design) -> list[str]:
    """Return a warning where one color lights everything; usually nothing."""
    if not design.monochrome:
        return []
    return [
        "The optimum is monochrome: the weight of the color term does not reward color "
        "differences in this scene, so surface azimuth will be hard to read."
    ]


def holder_warning(scene: Scene, design: Design) -> list[str]:
    """Return a warning for fibers that would meet in their holder; usually nothing."""
    return [
        f"This design cannot be built: {problem}."
        for problem in FiberHolder.of(scene).problems(design.phi)
    ]


def guessing_warning(scene: Scene, normal_error: float) -> list[str]:
    """Return a warning where a reader hardly does better than a guess; usually nothing.

    ``normal_error`` in degrees is that of the design.
    """
    guess = guessing_error(scene)
    if normal_error < GUESSING * guess:
        return []
    why = one_hue_advice(scene) or "light it from more sides, in more colors"
    return [
        f"Normals are read to {normal_error:.1f}°, and a guess misses them by {guess:.1f}°, "
        f"whatever S says: {why}."
    ]


def reader_verdict(names: tuple[str, str], errors: tuple[float, float]) -> str:
    """Return whose normals are read better, of two designs with these normal errors in degrees.

    >>> reader_verdict(("A", "B"), (1.93, 1.672))
    'B reads better (1.67° for 1.93°)'
    >>> reader_verdict(("A", "B"), (7.62, 20.24))
    'A reads better (7.62° for 20.24°)'
    >>> reader_verdict(("A", "B"), (1.93, 1.931))
    'both read alike (1.93°)'
    """
    (first, best), (last, _) = sorted(zip(errors, names, strict=True))
    low, high = f"{first:.2f}°", f"{last:.2f}°"
    return f"both read alike ({low})" if low == high else f"{best} reads better ({low} for {high})"


def clipping_warning(clipped: float) -> list[str]:
    """Return a warning where facets saturate, for their fraction; usually nothing."""
    if clipped <= CLIPPED:
        return []
    return [
        f"{clipped:.1%} of the facets saturate the camera in this design; lower its "
        "exposure or the LED power."
    ]


def preview_warnings(scene: Scene, level: str, photon_noise: float | None) -> list[str]:
    """Return what makes colors without renders less sure than they are elsewhere; usually nothing.

    That is more noise than its photons were meant to leave, and beams that are too narrow.
    """
    texts = []
    if photon_noise is not None and photon_noise > NOISE_LIMIT:
        texts.append(
            f"The traced light paths leave noise of {photon_noise:.1%} in its colors, more than "
            f"{NOISE_LIMIT:.0%}: intervals are wider for it; let renders decide (tactilux verify)."
        )
    beam = narrowest_turning_beam(scene)
    if (level == PREVIEW or photon_noise is not None) and beam < NARROW_BEAM:
        texts.append(
            f"Beams of {np.degrees(beam):.1f} deg light spots smaller than what previews tell "
            "apart: with 1 deg intervals held 57% of the scores; let renders decide (tactilux "
            "verify)."
        )
    return texts
