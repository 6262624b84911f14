"""Lamps joined over a bond bring the light that directions find which are followed one by one."""

from __future__ import annotations

from types import ModuleType

import drjit as dr
import numpy as np
import pytest

from render.cells.clear.bond_optics import WindowBond
from render.cells.clear.bonded_ways import LEVELS, BondedWays
from render.cells.clear.unfolded_cells import CODES, DEPTHS, LampWay
from render.cells.fiber_light import FiberLight
from render.geometry import facets
from render.scene import Scene
from tests.oracles.pads import scene_of_case

COUNT, DIRECTIONS = 1 << 15, 1 << 18
LEFT, TIP = 0, 1
STRAIGHT, OVER_LOWER, IN_WINDOW, WINDOW_OVER_LOWER, BY_BOND, TWICE, TWICE_AND_LOWER = range(7)
FROM_WINDOW, FROM_WINDOW_OVER_LOWER, FROM_WINDOW_BY_BOND = range(7, 10)
UP_AND_DOWN, DOWN_AND_UP, UP_INTO_PAD, OVER_LOWER_INTO_PAD = range(10, 14)
WHITE_TIP = "window, white, black and mirror walls"
# Points before white paint, and its normals.
RIGHT_WALL = (9.99, 1.0, -1.0), (-1.0, 0.0, 0.0)
TIP_WALL = (2.0, 11.99, -1.0), (0.0, -1.0, 0.0)


@pytest.mark.parametrize(
    ("case", "lamp", "site", "facet", "face", "cells", "level"),
    [
        ("window lit at its edges", 0, 1, 4, LEFT, (0, 0), IN_WINDOW),
        # A quarter of the lamp cannot be seen: its light would have to run along the bond.
        ("window lit at its edges", 1, 4, 0, TIP, (0, 0), IN_WINDOW),
        ("window lit at its edges", 0, 2, 4, LEFT, (0, 0), WINDOW_OVER_LOWER),
        ("window lit at its edges", 2, 2, 0, TIP, (1, 0), IN_WINDOW),
        ("window lit at its edges", 0, 2, 4, LEFT, (0, 0), TWICE),
        ("window of low index", 0, 2, 4, LEFT, (0, 0), TWICE_AND_LOWER),
        ("window of low index", 2, 3, 1, TIP, (0, 0), IN_WINDOW),
        ("window", 0, 2, 4, LEFT, (0, 0), STRAIGHT),
        ("window", 0, 2, 4, LEFT, (0, 0), OVER_LOWER),
        ("window of low index under the lamps", 0, 2, 4, LEFT, (0, 0), BY_BOND),
    ],
)
def test_a_lamp_brings_what_directions_find(
    mono: ModuleType, case: str, lamp: int, site: int, facet: int, face: int,
    cells: tuple[int, int], level: int,
) -> None:  # fmt: skip
    scene = scene_of_case(case)
    light = FiberLight(scene, np.full((scene.lamp_count, 1), 1.2), 0.0)
    ways = BondedWays(scene, light, WindowBond(scene))
    code = LampWay(face, (*cells, -level)).code
    entry = int(np.array(ways.entry_of)[lamp * (CODES + 1) + code])
    assert entry < ways.entries
    place = facets(scene, 0.0)
    a, n = place.centroid[site, facet] - [0.0, 0.0, 1e-3], place.normal[site, facet]
    joined_as_directions_find(mono, scene, ways, entry, lamp, a, n, face, cells, level)


@pytest.mark.parametrize(
    ("case", "lamp", "place", "face", "cells", "level"),
    [
        ("window with white walls", 0, RIGHT_WALL, LEFT, (0, 0), FROM_WINDOW),
        ("window with white walls", 0, RIGHT_WALL, LEFT, (0, 0), FROM_WINDOW_OVER_LOWER),
        ("window with white walls", 0, RIGHT_WALL, LEFT, (0, 0), FROM_WINDOW_BY_BOND),
        ("window with white walls", 0, RIGHT_WALL, LEFT, (0, 1), FROM_WINDOW),
        ("window with white walls", 0, RIGHT_WALL, LEFT, (0, 0), UP_AND_DOWN),
        ("window with white walls", 0, RIGHT_WALL, LEFT, (0, 0), DOWN_AND_UP),
        (WHITE_TIP, 1, TIP_WALL, LEFT, (0, 0), UP_INTO_PAD),
        (WHITE_TIP, 1, TIP_WALL, LEFT, (0, 0), OVER_LOWER_INTO_PAD),
    ],
)
def test_white_paint_around_the_window_is_lit_as_directions_find(
    mono: ModuleType, case: str, lamp: int, place: tuple[tuple[float, ...], tuple[float, ...]],
    face: int, cells: tuple[int, int], level: int,
) -> None:  # fmt: skip
    scene = scene_of_case(case)
    light = FiberLight(scene, np.full((scene.lamp_count, 1), 1.2), 0.0)
    ways = BondedWays(scene, light, WindowBond(scene))
    entry = int(np.array(ways.entry_of)[lamp * (CODES + 1) + LampWay(face, (*cells, -level)).code])
    assert entry < ways.entries
    a, n = map(np.array, place)
    joined_as_directions_find(mono, scene, ways, entry, lamp, a, n, face, cells, level)


def test_no_two_ways_of_a_lamp_have_one_number(mono: ModuleType) -> None:
    scene = scene_of_case("window with white walls")
    light = FiberLight(scene, np.full((scene.lamp_count, 1), 1.2), 0.0)
    ways = BondedWays(scene, light, WindowBond(scene))
    numbers = np.column_stack([np.array(ways.lamp_of), np.array(ways.code_of)])
    assert len(np.unique(numbers, axis=0)) == ways.entries
    assert len(LEVELS) <= DEPTHS


def joined_as_directions_find(
    mono: ModuleType, scene: Scene, ways: BondedWays, entry: int, lamp: int, a: np.ndarray,
    n: np.ndarray, face: int, cells: tuple[int, int], level: int,
) -> None:  # fmt: skip
    """Join ``a`` on a surface of the normal ``n`` to a lamp, and follow directions about that."""
    light = ways.light
    rng = np.random.default_rng(1)

    def lanes(values: np.ndarray) -> object:
        return mono.Float(np.asarray(values, dtype=np.float32))

    # ------------------------------ Joined ---------------------------------------------
    pick, x, y = (lanes(rng.random(COUNT)) for _ in range(3))
    start = mono.Point3f(*(lanes(np.full(COUNT, c)) for c in a))
    found = ways.join(mono.UInt32(entry), mono.UInt32(lamp), start, pick, mono.Point2f(x, y))
    carried = ways.along(mono.UInt32(lamp), found.line)
    cosine = dr.maximum(dr.dot(mono.Normal3f(*n.tolist()), found.direction), 0.0)
    each = carried.radiance[0] * cosine * found.through / carried.joined
    each = np.array(dr.select(found.valid & (carried.joined > 0), each, 0.0), dtype=np.float64)
    # ------------------------------ Directions about them ------------------------------
    aimed = np.array(found.direction).T[np.array(found.valid)]
    assert len(aimed) > COUNT / 50
    middle = aimed.mean(axis=0)
    turn = np.angle(np.exp(1j * (np.arctan2(*aimed.T[1::-1]) - np.arctan2(*middle[1::-1]))))
    around = [turn.min() - 0.02, turn.max() + 0.02]
    rise = [max(aimed[:, 2].min() - 0.02, -1.0), min(aimed[:, 2].max() + 0.02, 1.0)]
    azimuth = np.arctan2(*middle[1::-1]) + rng.uniform(*around, DIRECTIONS)
    z = rng.uniform(*rise, DIRECTIONS)
    d = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.ones(DIRECTIONS)])
    d *= np.column_stack([np.sqrt(1 - z**2)] * 2 + [z])
    ends, outside, through = followed(scene, a, d, face, cells, level)
    columns = (mono.Point3f(*map(lanes, ends.T)), mono.Vector3f(*map(lanes, -outside.T)))
    radiance = np.array(light.ray(mono.UInt32(lamp), *columns).radiance[0], dtype=np.float64)
    area = (around[1] - around[0]) * (rise[1] - rise[0])
    values = radiance * through * np.maximum(d @ n, 0.0) * area
    error = np.hypot(each.std() / np.sqrt(COUNT), values.std() / np.sqrt(DIRECTIONS))
    assert error < 0.01 * values.mean()
    assert abs(each.mean() - values.mean()) < 4 * error + 2.5e-3 * values.mean()


def followed(
    scene: Scene, a: np.ndarray, d: np.ndarray, face: int, cells: tuple[int, int], level: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Follow directions face by face; return where and how they leave, and what comes through.

    That is 0 for those that go another way than the one that is asked for.
    """
    assert scene.window is not None
    low, high = scene.box.low, scene.box.high
    pad, window = scene.pad.index, scene.window.index
    of, count = LEVELS[level], len(d)
    p, d, through = np.tile(a, (count, 1)), d.copy(), np.ones(count)
    below, going = np.full(count, a[2] < 0), np.ones(count, dtype=bool)
    if of.rises is not None:
        going &= (d[:, 2] > 0) == of.rises
    met = np.zeros((count, 2), dtype=int)
    passed, by_bond, by_lower = (np.zeros(count, dtype=int) for _ in range(3))
    outside, ended = np.zeros((count, 3)), np.zeros(count, dtype=bool)
    exit_axis, exit_side = (0, low[0]) if face == LEFT else (1, high[1])
    every = np.arange(count)
    for _ in range(12):
        bottom, top = np.where(below, low[2], 0.0), np.where(below, 0.0, high[2])
        planes = np.where(d > 0, high, low)
        planes[:, 2] = np.where(d[:, 2] > 0, top, bottom)
        with np.errstate(divide="ignore", invalid="ignore"):
            way = np.where(d != 0, (planes - p) / d, np.inf)
        axis = way.argmin(axis=1)
        p = p + np.where(going, way.min(axis=1), 0.0)[:, None] * d
        index, cosine = np.where(below, window, pad), np.abs(d[every, axis])
        reflected = fresnel(cosine, 1.0 / index)
        # Walls.
        wall = going & (axis < 2)
        leaves = wall & (axis == exit_axis) & (np.abs(p[:, exit_axis] - exit_side) < 1e-9)
        leaves &= (met == np.abs(cells)).all(axis=1)
        for i in (0, 1):
            met[wall & ~leaves & (axis == i), i] += 1
        through[wall] *= np.where(leaves, 1 - reflected, reflected)[wall]
        flips = wall & ~leaves
        # The lower face, and the skin, where ways end.
        down = d[:, 2] < 0
        lower = going & (axis == 2) & below & down
        by_lower[lower] += 1
        through[lower] *= reflected[lower]
        flips |= lower
        skin = going & (axis == 2) & ~below & ~down
        through[skin] = 0.0
        # The bond: reflected as often as asked, on the side of the last medium.
        bond = going & (axis == 2) & (below != down)
        share = fresnel(cosine, np.where(below, pad / window, window / pad))
        turns = bond & (by_bond < of.by_bond) & (below == of.in_window)
        by_bond[turns] += 1
        through[turns] *= share[turns]
        flips |= turns
        crosses = bond & ~turns
        passed[crosses] += 1
        through[crosses] *= (1 - share)[crosses]
        scale = np.where(below, window / pad, pad / window)
        d[crosses, :2] *= scale[crosses, None]
        rise = np.sqrt(np.maximum(1 - (d[:, :2] ** 2).sum(axis=1), 0.0))
        d[crosses, 2] = (np.sign(d[:, 2]) * rise)[crosses]
        below = np.where(crosses, ~below, below)
        d[every[flips], axis[flips]] *= -1
        along = index[:, None] * d
        along[:, exit_axis] = 0.0
        rest = np.maximum(1 - (along**2).sum(axis=1), 0.0)
        along[:, exit_axis] = np.sign(d[:, exit_axis]) * np.sqrt(rest)
        outside[leaves], ended[leaves] = along[leaves], True
        going &= ~leaves & ~skin & (through > 0)
    as_asked = ended & (passed == of.passed) & (by_bond == of.by_bond) & (by_lower == of.by_lower)
    as_asked &= below == of.in_window
    return p, outside, np.where(as_asked, through, 0.0)


def fresnel(cosine: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """Return what a face reflects behind which the index is ``ratio`` times as high."""
    sine = (1 - cosine**2) / ratio**2
    behind = np.sqrt(np.maximum(1 - sine, 0.0))
    s = (cosine - ratio * behind) / (cosine + ratio * behind)
    p = (ratio * cosine - behind) / (ratio * cosine + behind)
    return np.where(sine > 1, 1.0, (s**2 + p**2) / 2)
