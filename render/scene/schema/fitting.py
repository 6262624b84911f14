"""Whether the parts of a scene fit together: every reason why they do not, a sentence each."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

from render.scene.built_geometry import (
    aim_problems,
    can_be_placed,
    deep_row_problems,
    embedding_problems,
    embedding_under_skin_problems,
    listed_problems,
    placement_problems,
    row_problems,
    skin_problems,
)
from render.scene.catalog import entries_of, known_leds, naming_problems, own_problems
from render.scene.colors import OFF
from render.scene.faces import face_problems, painted_lamp_problems
from render.scene.lamps import Fibers, ListedLamp, Row
from render.scene.places.candidates import candidate_problems
from render.scene.quantities import keys_of_schema_2
from render.scene.sections import MIN_BONDED_INDEX
from render.scene.states import REST, site_problems, state_problems

if TYPE_CHECKING:
    from render.scene.schema.scene import Scene

MOST_LAMPS = 1024


def fitting_problems(scene: Scene) -> list[str]:
    """Return why the parts of a scene do not fit together, a sentence each; none where they do."""
    problems = []
    if scene.schema_version == 1:
        problems += [f"{key} needs schema = 2" for key in keys_of_schema_2(scene)]
        if scene.constraints and any(one.color == OFF for one in scene.constraints.fixed):
            problems.append(f"constraints.fixed: color = {OFF} needs schema = 2")
        if not isinstance(scene.coating.albedo, float):
            problems.append("coating.albedo with a list of values needs schema = 2")
    problems += scene.camera.problems()
    problems += scene.coating.problems(scene.palette.one_shot.channels)
    if scene.diffuser is not None:
        problems += scene.diffuser.problems()
    problems += face_problems(scene.faces or (), scene.diffuser_edges)
    problems += _window_problems(scene)
    angles = scene.bending.angles
    if any(b <= a for a, b in itertools.pairwise(angles)):
        shown = ", ".join(f"{math.degrees(angle):g}" for angle in angles)
        problems.append(f"bending.angles = {shown} deg, allowed: distinct and ascending")
    placing = _placing_problems(scene)
    problems += placing
    # Where places are wrong, what lies on the skin there says nothing.
    if not placing:
        problems += _embedding_problems(scene) if scene.skin is None else _skin_problems(scene)
    problems += own_problems(scene.parts or ())
    problems += _search_problems(scene, problems)
    palette = scene.palette
    problems += palette.problems(named=scene.colors is not None)
    if scene.constraints is not None:
        most = scene.search.lamps if scene.search is not None else None
        problems += scene.constraints.problems(palette.one_shot, scene.lamp_count, most)
    if scene.tolerances is not None and scene.tolerances.sigma_v is not None:
        parts: list[Row | ListedLamp] = [*scene.lamp_rows, *(scene.lamps or ())]
        if all(part.profile.sigma_v is None for part in parts):
            problems.append("tolerances.sigma_v: no lamp has a Gaussian profile, leave it out")
    for entry in scene.constraints.fixed if scene.constraints is not None else ():
        turning = scene.turning
        if entry.angle is not None and not (*turning, True)[min(entry.fiber, len(turning))]:
            problems.append(
                f"constraints.fixed: lamp {entry.fiber} does not turn, leave its angle out"
            )
    if scene.tolerances is not None and scene.diffuser is None:
        for name in ("scattering", "diffuser_thickness"):
            if getattr(scene.tolerances, name) is not None:
                problems.append(f"tolerances.{name}: the scene has no diffuser, leave it out")
    problems += _moving_layer_problems(scene, problems)
    if scene.free is not None:
        problems += scene.free.problems(scene.diffuser.free_values if scene.diffuser else {})
    return problems


def _search_problems(scene: Scene, others: list[str]) -> Iterator[str]:
    """Yield what is wrong with what a search may decide, where the rest of the scene is right."""
    if scene.search is None:
        return
    alone = list(scene.search.problems(scene.constraints, scene.lamp_count))
    if not others:
        own, channels = scene.parts or (), scene.palette.one_shot.channels
        named = list(naming_problems(scene.search.parts, own, channels, "search.parts"))
        leds = [known_leds(own)[name] for name in ([] if named else scene.search.parts)]
        entries = [entry.name for led in leds for entry in entries_of(led)]
        alone += named or scene.search.counting_problems(scene.palette.one_shot.names, entries)
    yield from alone
    if not alone and not others:
        yield from candidate_problems(scene)


def _placing_problems(scene: Scene) -> list[str]:
    """Return what is wrong with the places of lamps and sites, and with states."""
    problems = list(_lamp_problems(scene))
    if scene.indenter.depth >= scene.pad.thickness:
        problems.append(
            f"indenter: the pyramid is {scene.indenter.depth:g} mm deep, "
            f"allowed: below pad.thickness = {scene.pad.thickness:g} mm"
        )
    sites, clearance = scene.sites, scene.indenter.clearance
    if sites.count > 1 and sites.spacing < 2 * clearance:
        problems.append(
            f"sites.spacing = {sites.spacing:g} mm lets pyramids overlap, "
            f"allowed: at least 3 indenter.radius = {2 * clearance:g} mm"
        )
    half_x = abs(sites.centre_x) + (sites.columns - 1) / 2 * sites.spacing + clearance
    half_y = abs(sites.centre_y) + (sites.rows - 1) / 2 * sites.spacing + clearance
    if half_x > scene.pad.width / 2 or half_y > scene.pad.length / 2:
        problems.append(
            f"sites: the pyramids reach {half_x:g} x {half_y:g} mm from the pad's center, "
            f"allowed: at most {scene.pad.width / 2:g} x {scene.pad.length / 2:g} mm"
        )
    if scene.states is not None:
        problems += state_problems(scene.states, scene.skin, scene.pad, scene.bending.angles)
    return problems


def _moving_layer_problems(scene: Scene, others: list[str]) -> Iterator[str]:
    """Yield what would move the border of a diffuser to lamps that are cast in beside it."""
    if others or scene.diffuser is None:
        return
    cast = [number for number, lamp in enumerate(scene.placed_lamps()) if lamp.solid]
    for name, part in (("tolerances", scene.tolerances), ("free", scene.free)):
        if cast and part is not None and part.diffuser_thickness is not None:
            yield (
                f"{name}.diffuser_thickness: lamp {cast[0]} is cast into the silicone, and "
                "does not move with the diffuser, allowed: lamps in the air, or leave it out"
            )


def _skin_problems(scene: Scene) -> Iterator[str]:
    """Yield what is wrong with the skin, and in each of its states."""
    for number, name in zip(scene.state_axis, scene.state_names, strict=True):
        one = scene if scene.states is None else scene.in_state(number)
        assert one.skin is not None
        alone = list(
            skin_problems(
                one.skin,
                one.pad,
                one.bending,
                one.diffuser,
                one.placed_lamps(),
                one.sites,
                one.indenter,
            )
        )
        if not alone and name != REST:
            alone += placement_problems(one.placed_lamps(), one.box)
        if not alone:
            alone += _embedding_problems(one)
        if name == REST or scene.states is None:
            yield from alone
            if alone:  # states follow a skin that is right
                return
            continue
        yield from (f"states: in {name} {problem}" for problem in alone)
        if one.sites.carried is not None:
            yield from site_problems(one.sites, one.pad, one.indenter.clearance, name)


def _embedding_problems(scene: Scene) -> Iterator[str]:
    """Yield which lamps in the silicone reach through the skin, or into a pyramid."""
    lamps = scene.placed_lamps()
    if any(lamp.solid for lamp in lamps):
        yield from embedding_under_skin_problems(
            lamps, scene.pad, scene.skin, scene.sites, scene.indenter
        )


def _window_problems(scene: Scene) -> Iterator[str]:
    if scene.window is None:
        return
    if not scene.bending.rigid:
        shown = ", ".join(f"{math.degrees(angle):g}" for angle in scene.bending.angles)
        yield f"window: bending.angles = {shown} deg, allowed with a window: 0 deg alone"
    if scene.diffuser is not None:
        yield "window: there is a diffuser, allowed: one of the two, leave one out"
    if scene.skin is not None:
        yield f"window: skin.shape = {scene.skin.shape}, allowed with a window: a flat skin"
    if scene.pad.index < MIN_BONDED_INDEX:
        yield (
            f"window: pad.index = {scene.pad.index:g}, allowed with a window: at least "
            f"{MIN_BONDED_INDEX:g}"
        )
    depth, camera = scene.window.thickness, scene.camera
    placed = camera.position is not None and len(camera.position) == 3
    placed = placed or (camera.distance is not None and camera.y is not None)
    if placed and -depth <= camera.place[2] < 0.0:
        yield (
            f"window.thickness = {depth:g} mm reaches to the camera at z = "
            f"{camera.place[2]:g} mm, allowed: less than {-camera.place[2]:g} mm"
        )


def _lamp_problems(scene: Scene) -> Iterator[str]:
    pad, fibers, listed = scene.pad, scene.fibers, scene.lamps or ()
    if fibers is None and scene.schema_version == 1:
        yield "missing key fibers"
        return
    if fibers is not None and scene.rows is not None:
        yield "rows: fibers are three rows already, allowed: one of the two"
        return
    if scene.lamp_count == 0:
        named = "fibers: left, tip and right are all 0" if fibers else "there are no lamps"
        yield f"{named}, at least one {'fiber' if fibers else 'row or lamp'} is needed"
    if scene.lamp_count > MOST_LAMPS:
        yield f"there are {scene.lamp_count} lamps, allowed: at most {MOST_LAMPS}"
        return
    if fibers is not None:
        yield from _fiber_problems(scene, fibers)
    yield from row_problems(scene.rows or (), pad.width, pad.length)
    yield from listed_problems(listed)
    if can_be_placed(scene.rows or (), listed):
        placed = [lamp for lamp in scene.placed_lamps() if fibers is None or lamp.edge is None]
        yield from placement_problems(tuple(placed), scene.box)
        yield from aim_problems(tuple(placed))
        refracts = scene.window_refracts
        yield from embedding_problems(tuple(placed), scene.box, refracts=refracts)
        yield from deep_row_problems(scene.rows or (), tuple(placed))
        yield from painted_lamp_problems(scene.placed_lamps(), scene.finishes)
    lit = Counter[str]()
    for row in scene.lamp_rows:
        lit[row.edge] += row.size
    yield from scene.baseline.problems(+lit, len(listed), fibers is not None)


def _fiber_problems(scene: Scene, fibers: Fibers) -> Iterator[str]:
    if fibers.height > scene.pad.thickness:
        yield (
            f"fibers.height = {fibers.height:g} mm lies above the pad, "
            f"allowed: 0 to pad.thickness = {scene.pad.thickness:g} mm"
        )
    if fibers.diameter / 2 >= fibers.gap:
        yield (
            f"fibers.diameter = {fibers.diameter:g} mm cuts into the "
            f"{'diffuser' if scene.diffuser else 'pad'} when the fiber turns, allowed: below "
            f"2 fibers.gap = {2 * fibers.gap:g} mm ([[rows]] of schema = 2 need not turn)"
        )
    for row in fibers.rows():
        side = scene.pad.width if row.edge == "tip" else scene.pad.length
        needed = row.size * fibers.diameter
        if needed > side:
            yield (
                f"fibers.{row.edge} = {row.size} fibers need {needed:g} mm, "
                f"allowed: at most the edge of {side:g} mm"
            )
