"""The lobe of a skin in scene files: what is read, what is refused, and what it changes."""

from __future__ import annotations

from pathlib import Path

import pytest

from render.describe import describe
from render.errors import SceneError
from render.scene import Scene, load_scene, scene_content, scene_of, scene_text

TEXT = scene_text("digit")
PLAIN = load_scene("digit")


def scene_with(folder: Path, *lines: str, text: str = TEXT) -> Scene:
    """Return digit with more lines in its section coating."""
    path = folder / "scene.toml"
    path.write_text(text.replace("[coating]", "\n".join(["[coating]", *lines])))
    return load_scene(path)


def specular(value: float) -> str:
    return f'specular = {{ value = {value}, source = "gloss meter" }}'


def roughness(value: float) -> str:
    return f'roughness = {{ value = {value}, source = "gloss meter" }}'


def test_a_lobe_has_a_reflectance_and_a_roughness(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, specular(0.2), roughness(0.3))
    assert scene.coating.lobe == (0.2, 0.3)
    assert scene.coating.reflectance == pytest.approx(scene.coating.albedo + 0.2)
    assert scene_of(scene_content(scene)) == scene


def test_both_make_another_scene_and_none_the_same(tmp_path: Path) -> None:
    hashes = {
        scene_with(tmp_path, specular(share), roughness(alpha)).hash
        for share, alpha in ((0.2, 0.3), (0.1, 0.3), (0.2, 0.2))
    }
    assert len(hashes | {PLAIN.hash}) == 4
    assert scene_with(tmp_path).hash == PLAIN.hash
    assert load_scene("finger20").hash == "68471ad4c129ea4d"


def test_a_lobe_without_light_is_none(tmp_path: Path) -> None:
    scene = scene_with(tmp_path, specular(0.0), roughness(0.3))
    assert scene.coating.lobe is None
    assert scene.hash == PLAIN.hash


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ([specular(0.2)], "coating.specular: there is no coating.roughness, allowed: both or none"),
        (
            [roughness(0.2)],
            "coating.roughness: there is no coating.specular, allowed: both or none",
        ),
        ([specular(0.6), roughness(0.2)], "allowed: at most 0.55 for specular, together at most 1"),
        ([specular(0.2), roughness(0.01)], "coating.roughness = 0.01: allowed: 0.05 to 0.5"),
        ([specular(-0.1), roughness(0.1)], "coating.specular = -0.1: allowed: 0 to 1"),
    ],
)
def test_half_a_lobe_and_one_that_gives_light_away_are_refused(
    lines: list[str], said: str, tmp_path: Path
) -> None:
    assert PLAIN.coating.albedo == 0.45
    with pytest.raises(SceneError) as caught:
        scene_with(tmp_path, *lines)
    assert said in str(caught.value)
    assert str(caught.value).count("coating.") <= 2


def test_albedo_and_lobe_may_be_all_of_the_light(tmp_path: Path) -> None:
    assert scene_with(tmp_path, specular(0.55), roughness(0.2)).coating.reflectance == 1.0
    tenths = TEXT.replace("albedo = { value = 0.45", "albedo = { value = 0.7")
    assert tenths != TEXT
    # 0.7 + 0.3 is not 1.0 in floating point everywhere: rounding refuses nobody.
    scene_with(tmp_path, specular(0.3), roughness(0.2), text=tenths)


def test_files_of_schema_1_know_no_lobe(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"coating.specular needs schema = 2"):
        scene_with(tmp_path, specular(0.2), roughness(0.3), text=scene_text("finger20"))


def test_describe_says_what_previews_make_of_it(tmp_path: Path) -> None:
    told = describe(scene_with(tmp_path, specular(0.2), roughness(0.3)))
    what = [part.what for part in told.left_out]
    assert "specular lobe of the coating" not in what
    assert any("lobe sends from face to face" in each for each in what)
    assert any(value.key == "coating.roughness" and value.value == 0.3 for value in told.values)
    assert "specular lobe of the coating" in [part.what for part in describe(PLAIN).left_out]
