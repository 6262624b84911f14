"""What a scene declares, where every value comes from, and what is left out because of it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel

from render.arrays import Array
from render.geometry import FiberHolder, camera_coverage, counted_sites, flat_sites, seen_rule
from render.geometry.lamp_reach import light_shares, shares_before_face
from render.scene import (
    EDGES,
    FACES,
    RIM_EDGES,
    Constraints,
    FreeRanges,
    MeshHeights,
    PlacedLamp,
    Profile,
    Quantity,
    Scene,
    Search,
    Tolerances,
)

LITTLE_LIGHT = 0.02
"""Share of a lamp's light that meets the silicone, below which the lamp is told of."""
WHOLE_END = 0.98
"""Share of a lamp's end before its face, below which the lamp is told of."""


@dataclass(frozen=True)
class Value:
    """One value of the scene in file units; ``source`` is empty for counts and names."""

    key: str
    value: float | int | str | tuple[float, ...]
    unit: str
    source: str


@dataclass(frozen=True)
class OmittedPart:
    """A part of the model that this scene does not require."""

    what: str
    why: str


@dataclass(frozen=True)
class Description:
    """A scene in plain words.

    ``axes`` is the size of every axis of the transport (fiber, bend or state, site, facet, and
    channel where materials depend on it, as ``color_axis`` says); ``cells`` and
    ``background_cells`` count its numbers per direction node. ``seen`` says which sites count, and
    ``skin_tested`` is the share of the skin that they lie on; ``doubts`` what is hardly meant.
    """

    scene: str
    scene_hash: str
    values: tuple[Value, ...]
    axes: dict[str, int]
    cells: int
    background_cells: int
    seen: str
    skin_tested: float
    left_out: tuple[OmittedPart, ...]
    color_axis: str = ""
    limits: tuple[str, ...] = ()
    tolerances: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def _word(self) -> str:
        """What the sensor has several of, as `Scene.state_word`."""
        return next((name for name in ("bend", "state") if self.axes.get(name, 1) > 1), "")

    def to_json(self) -> dict[str, Any]:
        """Return the description as JSON-ready values."""
        return asdict(self)

    def text(self) -> str:
        """Return the description as lines for people."""
        shown = [(item.key, _shown(item), item.source) for item in self.values]
        key_width = max(len(key) for key, _, _ in shown)
        value_width = max(len(value) for _, value, _ in shown)
        rows = [
            f"  {key:<{key_width}}  {value:>{value_width}}  {source}".rstrip()
            for key, value, source in shown
        ]
        axes = " x ".join(
            f"{size} {name}{'s' * (size != 1)}"
            for name, size in self.axes.items()
            if name not in {"bend", "state"} or name == self._word
        )
        return "\n".join(
            [
                f"{self.scene} ({self.scene_hash})",
                *rows,
                f"cells per direction node: {axes} = {self.cells}, "
                f"and {self.background_cells} of the untouched pad",
                *([f"color axis of the transport: {self.color_axis}"] if self.color_axis else []),
                f"seen by the camera: {self.seen} ({seen_rule(self._word)})",
                f"sites that count lie on {self.skin_tested:.0%} of the skin",
                "left out, and why:",
                *(f"  {item.what}: {item.why}" for item in self.left_out),
                *_listed("limits of designs:", self.limits),
                *_listed("tolerances:", self.tolerances),
                *_listed("free, an input of the surrogate:", self.free),
                *_listed("worth a second look:", self.doubts),
            ]
        )


def describe(scene: Scene, origins: Mapping[str, str] | None = None) -> Description:
    """Return the description of a scene.

    ``origins`` has the source of every value, from `render.scene.sources` of the same file.

    Raises:
        SceneError: the camera sees no site whole.
    """
    axes = {
        "fiber": scene.lamp_count,
        "bend" if scene.states is None else "state": len(scene.state_axis),
        "site": len(counted_sites(scene)),
        "facet": scene.indenter.faces,
    }
    if scene.by_channel:
        axes["channel"] = len(scene.palette.channels)
    cells = math.prod(axes.values())
    values = tuple(_values(scene, origins or {}))
    return Description(
        scene=scene.name,
        scene_hash=scene.hash,
        values=values,
        axes=axes,
        cells=cells,
        background_cells=cells // scene.indenter.faces,
        seen=camera_coverage(scene).sentence,
        skin_tested=skin_tested(scene),
        color_axis=_color_axis(scene),
        left_out=tuple(OmittedPart(what, why) for what, why in _left_out(scene)),
        limits=tuple(limit_sentences(scene)),
        tolerances=tuple(scene.tolerances.sentences()) if scene.tolerances else (),
        free=tuple(scene.free.sentences()) if scene.free else (),
        doubts=(*_doubts(scene), *_stale(values)),
    )


def skin_tested(scene: Scene) -> float:
    """Return which part of the skin lies within the outermost contacts of the sites that count."""
    sides = np.ptp(flat_sites(scene)[:, :2], axis=0) + 2 * scene.indenter.radius
    return float(min(sides.prod() / (scene.pad.width * scene.pad.length), 1.0))


def stale_sources(scene: Scene, origins: Mapping[str, str]) -> list[str]:
    """Return which values were made from others that have changed, as their sources say."""
    return list(_stale(tuple(_values(scene, origins))))


def _stale(values: tuple[Value, ...]) -> Iterator[str]:
    """Yield values whose source names another value, ``pad.thickness = 4 mm``, of another size."""
    known = {item.key: (item, item.value) for item in values if isinstance(item.value, float)}
    for item in values:
        for key, said in re.findall(r"(\w+(?:\.\w+)+) = (-?\d+(?:\.\d+)?)", item.source):
            if key not in known:
                continue
            other, now = known[key]
            if not math.isclose(float(said), now, rel_tol=1e-4):
                yield (
                    f"{item.key} = {_shown(item)} comes from {key} = {said} {other.unit}, "
                    f"which is {_shown(other)} now: give it a value and a source of its own"
                )


def one_hue_advice(scene: Scene) -> str:
    """Return why hue says nothing about normals and what would change it; "" where it does."""
    palette = scene.palette
    if not palette.one_hue or scene.lamp_count == 1:
        return ""
    why = "all LEDs look alike to the camera"
    if len(palette.channels) == 1:
        why = "the camera has one channel"
    return (
        f"{why} and sees all lamps at once, so brightness alone tells normals: take a picture for "
        "each group of lamps (docs/scenes.md, shots), or LEDs and a camera of several colors"
    )


def _doubts(scene: Scene) -> Iterator[str]:
    """Yield what is hardly meant of colors, and of lamps: the first of a row."""
    if advice := one_hue_advice(scene):
        yield advice
    lamps = scene.placed_lamps()
    for number, share in _first_below(lamps, light_shares(scene), LITTLE_LIGHT):
        turned = " in its best direction" if lamps[number].turns else ""
        yield (
            f"of the light of lamp {number} ({lamps[number].key}) {share:.1%} meets the "
            f"silicone{turned}: aim it by its tilt or direction, or bring it nearer"
        )
    for number, share in _first_below(lamps, shares_before_face(scene), WHOLE_END):
        yield (
            f"of the end of lamp {number} ({lamps[number].key}) {share:.0%} stands before the "
            f"{FACES[lamps[number].face]} face, the rest beside it: is that meant?"
        )


def _first_below(
    lamps: tuple[PlacedLamp, ...], shares: Array, least: float
) -> Iterator[tuple[int, float]]:
    """Yield the first lamp of each row whose share is below ``least``, and the share."""
    told = set()
    for number, (lamp, share) in enumerate(zip(lamps, shares, strict=True)):
        if share < least and lamp.key not in told:
            told.add(lamp.key)
            yield number, float(share)


def limit_sentences(scene: Scene) -> Iterator[str]:
    """Yield what every search of designs for ``scene`` keeps to."""
    holder = FiberHolder.of(scene)
    if len(holder.least):
        yield holder.sentence
    if scene.constraints is not None:
        yield from scene.constraints.sentences(scene.palette.one_shot)
    if scene.search is not None:
        yield from scene.search.sentences()


def _color_axis(scene: Scene) -> str:
    """Return why transport has an axis of channels, "" where it has none."""
    if not scene.by_channel:
        return ""
    seen = zip(scene.palette.channels, scene.albedo_of_channel, strict=True)
    told = ", ".join(f"{scene.albedos[albedo]:g} in {channel}" for channel, albedo in seen)
    return f"coating.albedo is {told}"


def _listed(title: str, sentences: tuple[str, ...]) -> list[str]:
    return [title, *(f"  {sentence}" for sentence in sentences)] if sentences else []


def _values(part: BaseModel, origins: Mapping[str, str], prefix: str = "") -> Iterator[Value]:
    for name, info in type(part).model_fields.items():
        content, key = getattr(part, name), f"{prefix}{name}"
        if isinstance(content, Constraints | Search | Tolerances | FreeRanges):
            continue  # told in sentences of their own
        if name == "colors" and content is not None:
            for color in content:
                key = f"colors.{color.name}"
                yield Value(key, color.response, "", origins.get(key, ""))
            continue
        if isinstance(content, tuple) and content and isinstance(content[0], BaseModel):
            for number, entry in enumerate(content):
                yield from _values(entry, origins, f"{key}.{number}.")
        elif isinstance(content, Profile | MeshHeights):
            named = (
                origins[at]
                for at in (key, f"{key}.sigma_v", f"{key}.cosine_exponent")
                if at in origins
            )
            yield Value(key, content.sentence, "", next(named, ""))
        elif isinstance(content, BaseModel):
            yield from _values(content, origins, f"{key}.")
        elif prefix and content is not None:
            # The annotations of an optional value are those of the first of its types.
            said = [*info.metadata, *(m for t in get_args(info.annotation) for m in _metadata(t))]
            unit = next((item.unit for item in said if isinstance(item, Quantity)), "")
            yield Value(key, _in_file_units(content, unit), unit, origins.get(key, ""))


def _metadata(kind: Any) -> tuple[Any, ...]:
    return getattr(kind, "__metadata__", ())


def _in_file_units(content: Any, unit: str) -> Any:
    if unit != "deg":
        return content
    # Twelve digits undo the rounding of the conversion to radians and back.
    degrees = [float(f"{math.degrees(angle):.12g}") for angle in _tuple(content)]
    return tuple(degrees) if isinstance(content, tuple) else degrees[0]


def _tuple(content: Any) -> tuple[Any, ...]:
    return content if isinstance(content, tuple) else (content,)


def _shown(item: Value) -> str:
    words = {True: "yes", False: "no"}
    numbers = [
        part if isinstance(part, str) else words[part] if isinstance(part, bool) else f"{part:g}"
        for part in _tuple(item.value)
    ]
    return " ".join([", ".join(numbers), item.unit]).rstrip()


def _left_out(scene: Scene) -> Iterator[tuple[str, str]]:
    if scene.diffuser is None:
        yield "scattering medium", "no diffuser is declared, light enters the clear pad directly"
    if all(finish.smooth for finish in scene.finishes if finish.paint is None):
        yield (
            "rough refraction",
            "pad.roughness is 0, the faces to the air are smooth",
        )
    bright = [one for one in scene.finishes if one.paint is not None and one.paint.reflectance > 0]
    if bright and scene.diffuser is None and max(scene.bending.angles) > 0.0:
        yield (
            "light that painted edges of the bent pad send to and fro",
            "the preview follows one reflection at an edge where the pad bends: at 45 deg facets "
            "were off by 10 % (white) and 19 % (metal), 9 % without paint (median); the reference "
            "aims at no lamp over metal of a bent pad, so dim facets need many samples",
        )
    if scene.coating.lobe is None:
        yield "specular lobe of the coating", "the coating is declared Lambertian"
    else:
        yield (
            "light that the coating's lobe sends from face to face, in the preview",
            "there it counts as diffuse: where coating.specular is 0.4 facets were off by 13 % "
            "at a roughness of 0.1 and by 5 % at 0.5, as without a lobe, and by 14 % at 0.2 on a "
            "pad bent by 45 deg (median); traced light and the reference follow it",
        )
    cast = [number for number, lamp in enumerate(scene.placed_lamps()) if lamp.solid]
    if cast:
        which = f"lamp {cast[0]}" if len(cast) == 1 else f"lamps {', '.join(map(str, cast))}"
        yield (
            f"bodies and leads of {which}, cast into the silicone",
            "a lamp is a disk that hides no light; its power and profile are those of the light "
            "in the silicone",
        )
    if any(lamp.solid is None and FACES[lamp.face] == "lower" for lamp in scene.placed_lamps()):
        yield (
            "bodies of lamps below the pad",
            "a lamp is a disk that hides nothing from the camera, nor from the light of others",
        )
    if scene.skin is not None and scene.skin.mesh is not None:
        yield "lower side of skin.mesh", _height_of_mesh(scene.skin.mesh, scene.pad.thickness)
    yield "inside of the body", "it is black: light that leaves the silicone is lost"
    kind = "an equidistant fisheye" if scene.camera.fisheye else "a pinhole"
    yield "lens distortion", f"images are dewarped, the camera is {kind}"
    if not scene.by_channel:
        yield "color axis of the transport", "no material depends on the color channel"
    if scene.states is not None:
        yield (
            "motion of the body",
            "lower face, edges, lamps and camera stay where they are; between the edges the skin "
            "alone moves from state to state",
        )
    elif len(scene.state_axis) == 1:
        yield "other shapes of the skin", "one is declared"
    lit = {FACES[lamp.face] for lamp in scene.placed_lamps()}
    for edge in RIM_EDGES if scene.fibers is not None else EDGES:
        if edge not in lit:
            named = f"fibers.{edge} is 0" if scene.fibers else "no lamp stands before it"
            yield f"light from the {edge} edge", named


def _height_of_mesh(mesh: MeshHeights, crown: float) -> str:
    """Return where the skin of a mesh lies, and how high its body is in its file."""
    lowest = crown + min(mesh.heights) - mesh.crown
    body = f"; the body in its file is {mesh.body_height:.4g} mm high" if mesh.body_height else ""
    return (
        f"the skin is the upper side alone, {lowest:.3g} to {crown:.4g} mm over the pad's lower "
        f"face: its crown is at pad.thickness{body}"
    )
