"""What a model says about itself: the ``metadata_props`` of ``checker.onnx``, read and written.

Every value is a string in the file; numbers and tables are JSON. Needs no torch and no OpenGL.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from typing import Any, cast

from render.errors import ModelError
from render.files import parse_json
from render.levels import (
    EFFORTS,
    LEVELS,
    PREVIEW,
    REFERENCE,
    Effort,
    Level,
    level_name,
    level_of,
    read_level,
)
from render.metric import MetricConfig, current_conventions

SCHEMA = "tactilux-checker-2"
"""Version 2: exposure and lambda are those of the scene's preview, not of the training renders."""
NONE = "none"
"""Kind of the residual of a model without renders, or whose renders bear no correction out."""
NOISE = "noise of the reference"
"""Name of the held-out errors that a perfect model would have."""
LICENCE = "Apache-2.0"
MOST_CELLS, MOST_CHANNELS = 1_000_000, 64
"""Of lamps, sites or facets that a description may speak of; a model has 5 MB."""
UNITS = {
    "phi": "rad",
    "power": "fraction of full power",
    "bend": "rad",
    "counts": "camera counts, 0 to 255",
    "counts_spread": "camera counts, one standard deviation",
    "background": "camera counts of the untouched pad",
    "metric": "camera counts",
    "score": "camera counts",
    "domain_excess": "fraction of the trained range, 0 inside",
}
AXES = {
    "fiber": "around the pad, seen with the tip up: left edge from base to tip, tip edge from left "
    "to right, right edge from tip to base",
    "phi": "(batch, fiber): 0 towards the tip on the sides and towards +x at the tip; pi/2 is "
    "straight into the pad",
    "power": "(batch, fiber, channel)",
    "bend": "(batch, bend): total angle of the pad",
    "site": "row by row from the base, each row from -x to +x",
    "facet": "the normal of facet i of n leans by 2 pi i / n from the tip's direction, towards +x",
    "channel": "red, green, blue",
    "counts": "(batch, bend, site, facet, channel)",
    "counts_spread": "(batch, bend, site, facet, channel)",
    "background": "(batch, bend, site, channel)",
    "metric": "(batch, bend, site)",
    "score": "(batch)",
    "domain_excess": "(batch)",
}
"""What the axes of inputs and outputs are, and how they are counted."""


def axes_of(channels: Sequence[str]) -> dict[str, str]:
    """Return `AXES` of a camera with ``channels``."""
    return AXES | {"channel": ", ".join(channels)}


_LATER = {"material", "axes", "by_channel", "states"}
"""Properties that models of an earlier version lack, and that have a default."""


@dataclass(frozen=True)
class ModelMetadata:
    """The self-description of a model.

    Arguments:
        scene, scene_hash: the sensor that the model is of.
        fibers, sites, facets: sizes of the axes.
        scene_bends: the scene's own bends, rad; what scores are meant over.
        bounds: lowest and highest trained ``phi``, ``power`` and ``bend``.
        exposure: counts per 1/(mm^2 sr); lam: weight of M_phi in eq. (4.6).
        conventions: the metric's conventions.
        conformal: ``coverage``, ``counts`` (times counts_spread) and ``score`` (counts): the
            intervals prediction ± these hold the noise-free reference that often;
            ``score_spread`` is one standard deviation of the score; ``effort`` times how many
            samples would have said more of scores than the preview's interval, 1 where these did;
            ``checked`` gives the coverage found on cells that had no part in them.
        held_out: errors on held-out designs: rows of a ``name``, its ``level`` and ``effort``.
        preview: ``effort`` of the traced light that corrects it, None as drawn; nodes of the table
            and its interpolation error; ``ranks`` is the tau that such light was found to have on
            other sensors, ``photon_noise`` the relative noise of its colors.
        renderer: settings and sample counts of the reference; empty without renders.
        training_data_hash: SHA-256 of the reference table.
        git_revision, versions: the sources and packages that made the model.
        residual: kind and size of what corrects the preview.
        material: the free material: ``names``, ``low``, ``high`` and ``nominal`` of the quantities,
            the ``rendered`` materials, and the ``family`` hash of the scenes that it holds for;
            empty where nothing is free.
        by_channel: whether a fiber's light differs from channel to channel by more than its power,
            as the skin's albedo depends on the channel.
        states: names of the scene's states, whose numbers are what ``bend`` takes then; empty where
            its states are bends.
        axes, units, licence, schema: constants of this format.
    """

    scene: str
    scene_hash: str
    fibers: int
    sites: int
    facets: int
    scene_bends: list[float]
    bounds: dict[str, list[float]]
    exposure: float
    lam: float
    conventions: dict[str, Any]
    conformal: dict[str, Any]
    held_out: list[dict[str, Any]]
    preview: dict[str, Any]
    renderer: dict[str, Any]
    training_data_hash: str
    git_revision: str
    versions: dict[str, str]
    residual: dict[str, Any]
    units: dict[str, str]
    material: dict[str, Any] = field(default_factory=dict)
    by_channel: bool = False
    states: list[str] = field(default_factory=list)
    axes: dict[str, str] = field(default_factory=AXES.copy)
    licence: str = LICENCE
    schema: str = SCHEMA

    def to_props(self) -> dict[str, str]:
        """Return the properties to be stored in the file."""
        content = asdict(self)
        if not self.by_channel:
            del content["by_channel"]
        if not self.states:
            del content["states"]
        return {
            key: value if isinstance(value, str) else json.dumps(value, allow_nan=False)
            for key, value in content.items()
        }

    @property
    def effort(self) -> Effort | None:
        """What corrects the preview, and how far; None is the preview as drawn."""
        kind, traced = self.residual["kind"], self.preview["effort"]
        return cast(Effort | None, traced if kind == NONE else kind)

    @property
    def level(self) -> Level:
        """The level of its answers."""
        return level_of(self.effort)

    @property
    def preview_name(self) -> str:
        """Level and effort of the preview that a residual corrects."""
        return level_name(level_of(self.preview["effort"]), self.preview["effort"])

    @property
    def rendered(self) -> bool:
        """Whether it was held against renders of its sensor."""
        return bool(self.renderer)

    @property
    def own_errors(self) -> dict[str, Any] | None:
        """The row of ``held_out`` that has the model's own errors, None without one."""
        own = self.level, self.effort
        return next((row for row in self.held_out if (row["level"], row["effort"]) == own), None)

    @property
    def channels(self) -> list[str]:
        """Names of the camera's channels."""
        return self.axes["channel"].split(", ")

    @property
    def metric(self) -> MetricConfig:
        """The metric's conventions."""
        return MetricConfig(**current_conventions(self.conventions))


def read_props(props: Mapping[str, str], origin: str) -> ModelMetadata:
    """Return the metadata in ``props``.

    Raises:
        ModelError: the file is no model of ours, or its description is damaged.
    """
    if props.get("schema") == "tactilux-checker-1":
        raise ModelError(
            f"{origin} is a model of schema tactilux-checker-1, whose scores depend on how noisy "
            "its renders were: make it again with `tactilux train`",
            field="schema",
        )
    if props.get("schema") != SCHEMA:
        raise ModelError(
            f"{origin} is not a tactilux model of schema {SCHEMA} (it says "
            f"{props.get('schema', 'nothing')!r}): use a checker.onnx that `tactilux train` wrote",
            field="schema",
        )
    texts = {"scene", "scene_hash", "training_data_hash", "git_revision", "licence", "schema"}
    try:
        content: dict[str, Any] = {
            item.name: props[item.name] if item.name in texts else parse_json(props[item.name])
            for item in fields(ModelMetadata)
            if item.name not in _LATER or item.name in props
        }
        _bring_up_to_date(content)
        metadata = ModelMetadata(**content)
        for name, value, low, high in _numbers(metadata):
            _check_number(name, value, low, high)
        _check_words(metadata)
    except (KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise ModelError(
            f"{origin} has a damaged description ({error}): take a fresh copy of the model",
            field="metadata_props",
        ) from None
    return metadata


def held_out_row(errors: Mapping[str, Any], traced: str | None, kind: str) -> dict[str, Any]:
    """Return ``errors`` of a ``name``, with the level and the effort that it is of.

    ``traced`` is the effort of the preview beneath, ``kind`` that of the model's residual.
    """
    name, effort = errors["name"], traced if kind == NONE else kind
    if name in EFFORTS:
        effort = name
    elif name.startswith(PREVIEW):
        effort = traced
        name = name.replace(PREVIEW, level_name(level_of(traced), traced), 1)
    elif name == NOISE:
        return {**errors, "level": REFERENCE, "effort": None}
    return {**errors, "name": name, "level": level_of(effort), "effort": effort}


def _bring_up_to_date(content: dict[str, Any]) -> None:
    """Put level and effort where earlier versions had one word for a preview or a prediction."""
    preview, kind = content["preview"], content["residual"]["kind"]
    if "effort" not in preview:
        preview["effort"] = read_level(preview.pop("kind", PREVIEW))[1]
        content["held_out"] = [
            held_out_row({**row, "name": row["level"]}, preview["effort"], kind)
            for row in content["held_out"]
        ]


def _numbers(about: ModelMetadata) -> Iterator[tuple[str, Any, float, float]]:
    """Yield every number that a model is used by: name, value, least and largest.

    Raises:
        KeyError: one is missing; ValueError: a list has another length.
    """
    for name in ("fibers", "sites", "facets"):
        if not isinstance(getattr(about, name), int):
            raise ValueError(f"{name} is no whole number")
        yield name, getattr(about, name), 1, MOST_CELLS
    yield "exposure", about.exposure, math.ulp(0.0), math.inf
    yield "lam", about.lam, 0.0, math.inf
    yield "conformal.coverage", about.conformal["coverage"], 0.0, 1.0
    for name in ("counts", "score"):
        yield f"conformal.{name}", about.conformal[name], 0.0, math.inf
    farthest = max(len(about.states) - 1.0, 0.0) if about.states else math.pi
    for name, most in (("phi", math.pi), ("power", 1.0), ("bend", farthest)):
        low, high = about.bounds[name]
        yield f"bounds.{name}", low, 0.0, most
        yield f"bounds.{name}", high, low, most
    for bend in _some("scene_bends", about.scene_bends):
        yield "scene_bends", bend, 0.0, farthest
    for name, value in asdict(about.metric).items():
        yield f"conventions.{name}", value, 0.0, math.inf
    if about.material:
        free = about.material
        ends = zip(free["low"], free["nominal"], free["high"], free["names"], strict=True)
        for low, nominal, high, _ in ends:
            yield "material", low, -math.inf, high
            yield "material", nominal, -math.inf, math.inf
            yield "material", high, low, math.inf
    for row in about.held_out:
        yield "held_out.kendall_tau", row["kendall_tau"], -1.0, 1.0
        yield "held_out.facet_median", row["facet_median"], 0.0, math.inf
    for part, name, most in (
        ("preview", "phi_nodes", MOST_CELLS), ("preview", "ranks", 1.0),
        ("preview", "photon_noise", math.inf), ("residual", "unreliable_cells", math.inf),
        ("residual", "cells", math.inf), ("renderer", "samples_per_cell", math.inf),
    ):  # fmt: skip
        value = getattr(about, part).get(name)
        if value is not None:
            yield f"{part}.{name}", value, float(name == "cells"), most


def _some(name: str, values: Any) -> list[Any]:
    if not isinstance(values, list) or not 0 < len(values) <= MOST_CELLS:
        raise ValueError(f"{name} is no list of values")
    return values


def _check_number(name: str, value: Any, low: float, high: float) -> None:
    if not isinstance(value, int | float) or not (low <= value <= high and math.isfinite(value)):
        raise ValueError(f"{name} = {value!r:.40}, allowed: {low:g} to {high:g}")


def _check_words(about: ModelMetadata) -> None:
    """Refuse names that are none: what of them is read is text."""
    words = [about.scene, about.scene_hash, about.residual["kind"]]
    words += [row["name"] for row in about.held_out] + about.states + _some("axes", about.channels)
    if about.material:
        words += [about.material["family"], *about.material["names"]]
    if not all(isinstance(word, str) and word for word in words):
        raise ValueError("a name in it is empty or no text")
    known = [(row["level"], row["effort"]) for row in about.held_out]
    for level, effort in [(about.level, about.effort), *known]:
        if level not in LEVELS or effort not in (None, *EFFORTS):
            raise ValueError(f"{level!r:.40} of effort {effort!r:.40} is no level")
    if len(about.channels) > MOST_CHANNELS:
        raise ValueError(f"it has {len(about.channels)} channels, allowed: up to {MOST_CHANNELS}")
