"""``design.json``: a design with its rating, written atomically and read strictly.

Keys: ``schema``, ``scene``, ``scene_hash``, ``angles_deg``, ``colors`` (names), ``power`` (of each
LED of a fiber, in the order of ``palette``, or red, green, blue where there is none), ``level``
and ``effort``, ``score`` (with its interval), ``lam``, ``exposure``, ``conventions``, ``versions``.
Anything unknown, missing, out of range or made for another scene is refused.

Schema 2: exposure and lam are those of the scene's preview. Files of schema 1, whose scale depended
on how noisy a render was, are read as designs without a rating.
"""

from __future__ import annotations

import math
from codecs import BOM_UTF8
from dataclasses import asdict, dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AliasChoices,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    WrapValidator,
    model_validator,
)

from optimize.design.design import Design
from optimize.design.find_scene import find_scene
from optimize.design.rating import PARTS, RatedDesign, Rating, ReadErrors, ScoreSettings
from optimize.ui.provenance import package_versions
from render.arguments import as_kind, as_path, as_target
from render.errors import DesignError
from render.files import read_bytes, write_text
from render.levels import EARLIER, Effort, Level, read_level
from render.metric import MetricConfig, current_conventions
from render.refused_values import did_you_mean, in_json, problem_sentence, value_place
from render.scene import OFF, RGB, Palette, Scene, as_scene, load_scene
from render.scene.colors import MOST_SHOTS, with_shots

Angle = Annotated[float, Field(ge=0.0, le=180.0)]
Power = Annotated[float, Field(ge=0.0, le=1.0)]
Positive = Annotated[float, Field(gt=0.0)]
HASH = r"^[0-9a-f]{16}$"
_PATTERNS = {HASH: "16 of 0-9 and a-f"}


@dataclass(frozen=True)
class _Conventions(MetricConfig):
    __pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


class _Score(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    value: float
    interval: tuple[float, float]
    mean: float
    spread_sites: float
    spread_bends: float


class _ReadErrors(BaseModel):
    """What readers make of the design, see `ReadErrors`."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    reader_error_deg: Annotated[float, Field(ge=0.0)]
    normal_error_deg: Annotated[float, Field(ge=0.0)]
    exposure_factor: Positive
    gain: Annotated[float, Field(ge=1.0)]
    saturates_deg: Annotated[
        tuple[Annotated[float, Field(ge=0.0)] | None, ...], Field(strict=False)
    ] = ()


class _Palette(BaseModel):
    """The LEDs of a scene that has others than the default ones."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    names: Annotated[list[str], Field(min_length=1)]
    channels: Annotated[list[str], Field(min_length=1)]
    response: list[list[Power]]
    inks: list[str]
    shots: Annotated[int, Field(ge=1, le=MOST_SHOTS)] = 1

    def in_memory(self) -> Palette:
        """Return the palette itself."""
        response = tuple(map(tuple, self.response))
        names, channels, inks = tuple(self.names), tuple(self.channels), tuple(self.inks)
        palette = Palette(names, response, channels, inks, self.shots)
        if len(response) != len(self.names) or len(self.inks) != len(self.names):
            raise ValueError("palette: names, response and inks need one entry per LED")
        if self.shots > 1 and palette != with_shots(palette.one_shot, self.shots):
            raise ValueError(
                f"palette: names, channels and response are not those of {self.shots} shots of one "
                "picture, allowed: as tactilux writes them"
            )
        for problem in palette.problems():
            raise ValueError(f"palette: {problem}")
        return palette


class DesignFile(BaseModel):
    """The content of a design file; all of it belongs together."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    schema_version: Annotated[Literal[1, 2], Field(alias="schema")]
    scene: Annotated[str, Field(min_length=1)]
    scene_hash: Annotated[str, Field(pattern=HASH)]
    angles_deg: Annotated[list[Angle], Field(min_length=1)]
    colors: Annotated[
        list[str],
        Field(validation_alias=AliasChoices("colors", "colours")),  # as it was once spelled
    ]
    power: list[list[Power]]
    palette: _Palette | None = None
    level: Annotated[
        Level | None,
        WrapValidator(lambda c, check: c if isinstance(c, str) and c in EARLIER else check(c)),
    ]
    effort: Effort | None = None
    score: _Score | None
    read: _ReadErrors | None = None
    lam: Annotated[float, Field(ge=0.0)] | None
    exposure: Positive | None
    conventions: Annotated[
        _Conventions | None,
        BeforeValidator(lambda c: current_conventions(c) if isinstance(c, dict) else c),
    ]
    versions: dict[str, str]

    @property
    def design(self) -> Design:
        """The directions and the powers."""
        phi = np.minimum(np.radians(np.array(self.angles_deg)), math.pi)
        return Design(phi, np.array(self.power), self._palette)

    @property
    def _palette(self) -> Palette:
        return RGB if self.palette is None else self.palette.in_memory()

    @property
    def rating(self) -> Rating | None:
        """How good it is, if it was rated on today's scale."""
        if self.schema_version == 1:
            return None
        if not (self.level and self.score and self.exposure and self.conventions):
            return None
        assert self.lam is not None  # all or none, see below
        conventions = MetricConfig(**asdict(self.conventions))
        score = self.score.model_dump()
        settings = ScoreSettings(self.exposure, self.lam, conventions)
        parts = score | {"score": score["value"]}
        rating = settings.rating(self.level, parts, score["interval"], self.effort)
        read = None if self.read is None else ReadErrors(**self.read.model_dump())
        return replace(rating, read=read)

    @model_validator(mode="after")
    def _parts_agree(self) -> DesignFile:
        if self.level is not None:
            self.level, self.effort = read_level(self.level, self.effort)
        lengths = {len(self.angles_deg), len(self.colors), len(self.power)}
        if len(lengths) > 1:
            raise ValueError(
                f"angles_deg, colors and power have lengths {len(self.angles_deg)}, "
                f"{len(self.colors)} and {len(self.power)}, allowed: one entry per fiber in each"
            )
        palette = self._palette
        known = (*palette.names, OFF)
        for fiber, name in enumerate(self.colors):
            if name not in known:
                meant = did_you_mean(name, known)
                raise ValueError(
                    f"colors[{fiber}] = {in_json(name)}, allowed: {', '.join(known)}{meant}"
                )
        for fiber, row in enumerate(self.power):
            if len(row) != len(palette.names):
                raise ValueError(
                    f"power[{fiber}] has {len(row)} value{'s' * (len(row) != 1)}, allowed: "
                    f"{len(palette.names)}, one for each of {', '.join(palette.names)}"
                )
        design = Design(np.zeros(len(self.power)), np.array(self.power), palette)
        names = design.color_names
        if names != self.colors:
            fiber = next(i for i, name in enumerate(names) if name != self.colors[i])
            raise ValueError(
                f"colors[{fiber}] = {self.colors[fiber]} contradicts power[{fiber}], "
                f"allowed: {names[fiber]}"
            )
        rated = [self.level, self.score, self.lam, self.exposure, self.conventions]
        if len({part is None for part in rated}) > 1:
            raise ValueError(
                "level, score, lam, exposure and conventions must be given together or all be null"
            )
        return self


def save_design(
    path: str | Path, design: Design, scene: Scene | str | Path, rating: Rating | None = None
) -> None:
    """Write ``design`` for ``scene``, its name or its file, with its rating, atomically.

    Raises:
        DesignError: the design is not one of the scene's, its rating is not finite, or ``path`` is
            a folder.
    """
    path, scene = as_target(path, "path", DesignError), as_scene(scene)
    design = as_kind(design, Design, "design", "a Design", DesignError)
    if rating is not None:
        as_kind(rating, Rating, "rating", "the rating of a design", DesignError)
    design.check_fiber_count(scene)
    content = {
        "schema": 2,
        "scene": scene.name,
        "scene_hash": scene.hash,
        "angles_deg": np.degrees(design.phi).tolist(),
        "colors": design.color_names,
        "power": design.drive.tolist(),
        **palette_in_file(design.palette),
        **_rating_to_json(rating),
        "versions": package_versions("numpy"),
    }
    try:
        file = DesignFile.model_validate(content)
    except ValidationError as error:
        raise _refusal("the design to be saved", error) from None
    left_out = {"palette"} if file.palette is None else None
    text = file.model_dump_json(by_alias=True, indent=2, exclude=left_out)
    write_text(path, text + "\n")


def as_design(value: Design | str | Path, scene: Scene) -> Design:
    """Return the design that is given, or that of a file, made for ``scene``.

    Raises:
        DesignError: it is none, or not one of the scene's.
    """
    if isinstance(value, str | PathLike):
        return load_design(as_path(value, "design", DesignError), scene)
    as_kind(value, Design, "design", "a Design or the path of a design.json", DesignError)
    value.check_fits(scene)
    return value


def load_design(path: str | Path, scene: Scene | str | Path) -> Design:
    """Return the design in ``path``, which must have been made for ``scene``, its name or its file.

    Raises:
        DesignError: names what is wrong with the file, or that it is for another scene.
    """
    path, scene = as_path(path, "path", DesignError), as_scene(scene)
    saved = load_design_file(path)
    if saved.scene_hash != scene.hash:
        raise DesignError(
            f"{path} was made for another scene ({saved.scene}, hash {saved.scene_hash}), allowed: "
            f"hash {scene.hash} of {scene.name}; pass the scene it was made for or explore anew",
            field="scene_hash",
        )
    saved.design.check_fits(scene, str(path))
    return saved.design


def load_design_file(path: Path) -> DesignFile:
    """Return everything in a design file, whatever scene it is for.

    Raises:
        DesignError: names every problem of the file at once.
    """
    try:
        text = read_bytes(path).removeprefix(BOM_UTF8)  # which editors on Windows put in front
    except OSError as error:
        raise DesignError(
            f"{path} cannot be read: {error.strerror}; give the path of a design.json",
            field="design",
        ) from None
    try:
        return DesignFile.model_validate_json(text)
    except ValidationError as error:
        raise _refusal(str(path), error) from None


def open_rated(path: Path, scene_name: str | None = None) -> RatedDesign:
    """Return the design in ``path`` with its scene, which is the one that the file names.

    Raises:
        DesignError: the file is bad, unrated, or for another scene than the one given.
    """
    saved = load_design_file(path)
    named = scene_name or find_scene(saved.scene, path, saved.scene_hash)
    if named is None:
        raise DesignError(
            f"{path} is for scene {saved.scene}, which does not come with tactilux, and there is "
            f"no {saved.scene}.toml here: name its TOML file",
            field="scene",
            option="--scene",
        )
    scene = load_scene(named)
    design = load_design(path, scene)
    if saved.rating is None:
        raise DesignError(
            f"{path} has no score on the scale of its scene: rate it with "
            f"tactilux score {path} --out {path}",
            field="score",
        )
    return RatedDesign(scene, design, saved.rating)


def palette_in_file(palette: Palette) -> dict[str, Any]:
    """Return what a design file says of its LEDs: nothing of red, green and blue alone."""
    if palette == RGB:
        return {}
    fields = ("names", "channels", "response", "inks")
    lists = {name: np.array(getattr(palette, name)).tolist() for name in fields}
    return {"palette": lists | ({"shots": palette.shots} if palette.shots > 1 else {})}


def _rating_to_json(rating: Rating | None) -> dict[str, Any]:
    if rating is None:
        return dict.fromkeys(("level", "effort", "score", "read", "lam", "exposure", "conventions"))
    return {
        "level": rating.level,
        "effort": rating.effort,
        "score": {
            "value": rating.score,
            "interval": rating.interval,
            **{part: getattr(rating, part) for part in PARTS[1:]},
        },
        "read": None if rating.read is None else asdict(rating.read),
        "lam": rating.settings.lam,
        "exposure": rating.settings.exposure,
        "conventions": _Conventions(**asdict(rating.settings.conventions)),
    }


def _refusal(origin: str, error: ValidationError) -> DesignError:
    problems = error.errors(include_url=False)
    return DesignError(
        f"{origin} is not a valid design: "
        + "; ".join(problem_sentence(problem, _PATTERNS) for problem in problems),
        field=value_place(problems[0]),
    )
