"""The search section says what may be chosen, changes no scene, and refuses what cannot be."""

from __future__ import annotations

from pathlib import Path

import pytest

from render.errors import SceneError
from render.scene import Scene, load_scene, scene_content, scene_of, scene_text

RAIL = '[[search.places]]\nedge = "{}"\n'


def quantity(value: object, unit: str = "mm") -> str:
    return f'{{ value = {value}, unit = "{unit}", source = "test" }}'


def digit_with(folder: Path, *lines: str) -> Scene:
    path = folder / "mine.toml"
    path.write_text(scene_text("digit") + "\n[search]\n" + "\n".join(lines) + "\n")
    return load_scene(path)


def test_it_changes_no_hash_and_does_not_travel_with_renders(tmp_path: Path) -> None:
    plain = load_scene("digit")
    scene = digit_with(tmp_path, "lamps = 2", RAIL.format("left"))
    assert scene.search is not None
    assert scene.hash == plain.hash
    assert scene_of(scene_content(scene)).search is None


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ((), "search names nothing, allowed: lamps, places, keep_out, apart or mirror"),
        (("lamps = 0",), "search.lamps = 0: allowed: 1 to 1024"),
        (("lamp = 2",), "unknown key search.lamp, did you mean lamps?"),
        ((RAIL.format("left"), "pich = 2"), "unknown key search.places.0.pich, did you mean pitch"),
        ((RAIL.format("top"),), "search.places.0.edge"),
        ((RAIL.format("left"), "like = 3"), "like = 3, allowed: the number of a lamp, 0 to 2"),
        (
            (RAIL.format("left"), f"between = {quantity([3.0, -3.0])}"),
            "search.places.0.between = 3, -3 mm, allowed: two places, ascending",
        ),
        (
            (RAIL.format("left"), f"between = {quantity([-14.0, 3.0])}"),
            "search.places.0.between = 14 mm lies beside the edge, allowed: -12.5 to 12.5 mm",
        ),
        (
            (RAIL.format("tip"), f"at = {quantity([0.0])}", f"pitch = {quantity(2.0)}"),
            "at names the places already, allowed: without between and pitch",
        ),
        (
            (RAIL.format("left"), f"heights = {quantity([2.0, 9.0])}"),
            "search.places.0, the left edge: a lamp at z = 9 mm lies above the pad, allowed: at "
            "most its thickness of 6.15 mm",
        ),
        (
            (RAIL.format("left"), f"gap = {quantity(-1.0)}", f"tilt = {quantity(60.0, 'deg')}",
             f"heights = {quantity([5.9])}"),
            "search.places.0, the left edge: a lamp at (-8.15, -11.7, 5.9) mm is inside the pad",
        ),
        (
            (RAIL.format("left"), f"pitch = {quantity(0.05)}"),
            "search.places have 475 places, allowed: at most 256; take a larger pitch",
        ),
        (
            ("[[search.keep_out]]", 'edge = "tip"', f"between = {quantity([2.0])}"),
            "search.keep_out.0.between = 2 mm, allowed: two places, ascending",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_is_one_sentence_with_its_key(
    lines: tuple[str, ...], said: str, tmp_path: Path
) -> None:
    with pytest.raises(SceneError) as refused:
        digit_with(tmp_path, *lines)
    assert said in str(refused.value)


def test_schema_1_has_none(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(scene_text("finger20") + "\n[search]\nlamps = 3\n")
    with pytest.raises(SceneError, match="search needs schema = 2"):
        load_scene(path)


def test_more_lamps_fixed_than_may_be_lit_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    fixed = '[constraints]\nfixed = [{fiber = 0, color = "red"}, {fiber = 1, color = "blue"}]\n'
    path.write_text(scene_text("digit") + fixed + "[search]\nlamps = 1\n")
    with pytest.raises(SceneError, match=r"search.lamps = 1, but .* lights 2 .* at least 2"):
        load_scene(path)
