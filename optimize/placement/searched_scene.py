"""The scene that a placement search works on: its own lamps, and one that is off on every place.

The scene's own lamps keep their numbers, so that its baseline is the same design, and a lamp that
is off changes no light: it hides nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import tomlkit

from optimize.placement.part_lamps import list_colors, named_leds, part_lamps
from render.errors import SceneError
from render.scene import OFF, RGB, Scene
from render.scene.places import MOST_CANDIDATES, CandidateLamp, candidates_on, usual_rails
from render.scene.scene_file import scene_from_text, written_of
from render.scene.schema.toml_document import (
    body_of,
    in_line,
    lamp_table,
    listed_document,
    table_of,
    text_of,
)

PLACES, SHOTS = "-places", "-shots"
"""What the name of a scene ends with whose places are listed, or that takes other shots."""
LONGEST_NAME = 64
MOST_PART_LAMPS = 512
"""Own lamps and those of parts together; a table of so many takes some gigabytes."""


@dataclass(frozen=True)
class SearchSpace:
    """What may be chosen on a sensor beside colors and directions.

    Arguments:
        place: lamps may sit elsewhere, as on a scene that names places.
        lamps, parts, shots: see `searched_scene`; what its file says unless given.
    """

    place: bool = False
    lamps: int | None = None
    parts: tuple[str, ...] | None = None
    shots: int | None = None

    def places_on(self, scene: Scene) -> bool:
        """Return whether lamps of ``scene`` may sit elsewhere."""
        return self.place or bool(scene.search and scene.search.places)

    def on(self, scene: Scene) -> Scene:
        """Return the scene of all designs of a sensor: itself where it has no more of them."""
        place, listed = self.places_on(scene), bool(scene.search and scene.search.parts)
        if not (place or listed or self.parts) and self.lamps is None and self.shots is None:
            return scene
        return searched_scene(
            scene, place=place, lamps=self.lamps, parts=self.parts, shots=self.shots
        )

    @property
    def flags(self) -> list[str]:
        """What is given, as the command line has it."""
        words = ["--place"] * self.place
        words += [f"--lamps {self.lamps}"] * (self.lamps is not None)
        words += [f"--parts {','.join(self.parts or ())}"] * (self.parts is not None)
        return words + [f"--shots {self.shots}"] * (self.shots is not None)


def ending_in(name: str, ending: str) -> str:
    """Return the name of a scene that is made from another one's, with one ``ending``."""
    return name.removesuffix(ending)[: LONGEST_NAME - len(ending)] + ending


def searched_scene(
    scene: Scene,
    *,
    place: bool = True,
    lamps: int | None = None,
    parts: Sequence[str] | None = None,
    shots: int | None = None,
    candidates: Sequence[CandidateLamp] | None = None,
) -> Scene:
    """Return the scene of all designs that may be chosen, with a file of its own.

    Arguments:
        scene: the sensor; what its ``[search]`` says is kept to.
        place: whether lamps may sit elsewhere: on its rails, or else along every edge that holds
            lamps of its kind.
        lamps: at most so many lit; where no places are searched all colors stay free. By default
            as many as the scene says, or the baseline lights.
        parts: LEDs, of which every lamp is one; by default those that the scene says. Where there
            are any, each place has a lamp for every body among them, of which one may be lit, and
            the colors are the parts'.
        shots: pictures that are taken one after the other; as many as the scene says unless given.
        candidates: the places; by default all those that `candidates_of` has.

    Where lamps may sit elsewhere, there are as many of each color as the baseline lights, unless
    its constraints or its search say how many, lamps are mirrored, or more may be lit than the
    baseline lights.

    Raises:
        SceneError: the scene has no file, no place is left, so many lamps cannot be, or a part is
            none or does not fit.
    """
    if candidates is None:
        candidates = candidates_of(scene) if place else ()
    option = "" if parts is None else "--parts"
    if parts is None:
        parts = scene.search.parts if scene.search is not None else ()
    leds = named_leds(scene, parts, option)
    added = part_lamps(scene, leds, candidates, option) if leds else []
    lit = [color for color in scene.baseline_colors() if color != OFF]
    said = scene.search.lamps if scene.search is not None else None
    most = lamps if lamps is not None else said if said is not None else len(lit)
    count = scene.lamp_count + len(candidates)
    if leds and scene.lamp_count + len(added) > MOST_PART_LAMPS:
        raise SceneError(
            f"{count} places with {len({led.body for led in leds})} bodies of parts are "
            f"{len(added)} lamps, allowed: {MOST_PART_LAMPS}; name fewer parts, or "
            "[[search.places]] with a larger pitch",
            field="search.parts",
        )
    if not 1 <= most <= count:
        raise SceneError(
            f"{'search.lamps' if lamps is None else 'lamps'} = {most}, allowed: 1 to {count}, as "
            f"many as {scene.name} has{' with its places' * bool(candidates)}",
            field="search.lamps" if lamps is None else "lamps",
            option="" if lamps is None else "--lamps",
        )
    document = listed_document(scene)
    if shots is not None and shots != scene.palette.shots:
        document["camera"]["shots"] = shots
        document["name"] = ending_in(scene.name, SHOTS)
    if candidates or leds:
        if leds:
            list_colors(document, scene, leds)
            table_of(document, "constraints")["off"] = True
        else:
            added = _lamps_on(document, scene, candidates)
            _limit_colors(document, scene, lit, most)
        _add_lamps(document, scene, added)
        document["name"] = ending_in(document["name"], PLACES)
    search = table_of(document, "search")
    search["lamps"] = most
    if leds:
        search["parts"] = in_line([led.name for led in leds])
    search.pop("places", None)
    folder = written_of(scene).folder
    return scene_from_text(text_of(document), f"{scene.name} with its places", folder)


def with_places(scene: Scene) -> Scene:
    """Return the scene that a search of ``scene`` works on: with its places, if it names some.

    Raises:
        SceneError: as `searched_scene` does.
    """
    named = scene.search is not None and scene.search.places
    return searched_scene(scene) if named else scene


def candidates_of(scene: Scene) -> tuple[CandidateLamp, ...]:
    """Return the places of a scene: those on its rails, or else along every edge for its lamps.

    Raises:
        SceneError: there are none, or too many.
    """
    rails = scene.search.places if scene.search is not None else ()
    found = candidates_on(scene, rails or usual_rails(scene))
    if not found:
        raise SceneError(
            f"{scene.name} has no place for a lamp along its edges that is not taken, allowed: "
            "[[search.places]] in its file that name where lamps may sit",
            field="search.places",
        )
    if len(found) > MOST_CANDIDATES:
        raise SceneError(
            f"the edges of {scene.name} have {len(found)} places, allowed: at most "
            f"{MOST_CANDIDATES}; name [[search.places]] with a larger pitch in its file",
            field="search.places",
        )
    return found


def _lamps_on(
    document: tomlkit.TOMLDocument, scene: Scene, candidates: Sequence[CandidateLamp]
) -> list[dict[str, Any]]:
    """Return a lamp for every place, with the body of one of the scene's."""
    placed, lamps = scene.placed_lamps(), []
    for candidate in candidates:
        source = f"searched: {candidate.words}, like lamp {candidate.like} of {scene.name}"
        body = body_of(document, placed[candidate.like].key)
        lamps.append(
            {
                "position": {"value": candidate.position.tolist(), "unit": "mm", "source": source},
                "direction": {"value": candidate.direction.tolist(), "source": source},
                **body | ({"turns": False} if candidate.upright else {}),
            }
        )
    return lamps


def _add_lamps(
    document: tomlkit.TOMLDocument, scene: Scene, added: Sequence[dict[str, Any]]
) -> None:
    """List lamps, and leave them off in the baseline."""
    lamps = document["lamps"] if "lamps" in document else tomlkit.aot()
    for lamp in added:
        lamps.append(lamp_table(lamp))
    if added:
        document["lamps"] = lamps
    baseline = table_of(document, "baseline")
    baseline["lamps"] = in_line([*(scene.baseline.lamps or ()), *(OFF for _ in added)])


def _limit_colors(
    document: tomlkit.TOMLDocument, scene: Scene, lit: Sequence[str], most: int
) -> None:
    """Say that lamps may be off, and how many of each color there are."""
    constraints, given = table_of(document, "constraints"), scene.constraints
    constraints["off"] = True
    names, palette = scene.palette.one_shot.names, scene.palette
    lit = [names[palette.led[palette.index(color)]] for color in lit]
    counted = given is not None and any(given.of_color(name).max is not None for name in names)
    search = scene.search
    said = search is not None and bool(search.mirror or search.counts)
    if counted or said or most > len(lit):
        return
    for name in names:
        if name in RGB.names and not (given and given.colors and name in given.colors):
            constraints[f"max_{name}"] = lit.count(name)
        else:
            colors = constraints.setdefault("colors", tomlkit.table())
            colors.setdefault(name, tomlkit.inline_table())["max"] = lit.count(name)
