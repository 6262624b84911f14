"""Scene files with states of a skin: what they hold, and every mistake in one clear sentence."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from render.describe import describe
from render.errors import SceneError
from render.scene import (
    scene_content,
    scene_of,
    scene_text,
    sources,
    standalone,
)
from render.scene.json_schema import scene_schema
from tests.oracles.soft_domes import (
    CROWN,
    MOVES,
    moved_body,
    rest_body,
    round_scene_text,
    scene_text_of,
    write_files,
    written,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dome")
    write_files(folder, steps=16)
    return folder


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(SceneError) as caught:
        written(folder, text)
    return str(caught.value)


def refused_body(folder: Path, body: trimesh.Trimesh) -> str:
    body.export(folder / "odd.stl")
    return refusal(folder, scene_text_of("odd"))


def test_states_change_the_hash_and_their_names_and_sources_do_not(folder: Path) -> None:
    text = scene_text_of("pressed")
    scene, plain = written(folder, text), written(folder, scene_text_of())
    assert scene.hash != plain.hash
    assert scene.state_names == ("rest", "pressed")
    assert scene.state_axis == (0.0, 1.0)
    assert plain.state_names == ("bend 0°",)
    renamed = text.replace('"pressed"', '"touched"', 1).replace("simulation", "scan")
    assert written(folder, renamed).hash == scene.hash
    assert written(folder, scene_text_of("twisted")).hash != scene.hash


def test_states_travel_with_their_scene(folder: Path, tmp_path: Path) -> None:
    scene = written(folder, scene_text_of(*MOVES))
    assert scene_of(scene_content(scene)) == scene
    moved = scene.in_state(2.0)
    assert scene_of(scene_content(moved)) == moved
    copy = standalone(folder / "scene.toml")
    assert set(copy.files) == {"rest.stl", "pressed.stl", "twisted.stl", "low.stl"}
    elsewhere = scene_text_of("pressed").replace('"pressed.stl"', f'"{folder}/pressed.stl"')
    shutil.copy(folder / "rest.stl", tmp_path)
    far = written(tmp_path, elsewhere)
    copy = standalone(tmp_path / "scene.toml")
    kept = tmp_path / "kept"
    for name, content in copy.files.items():
        (kept / name).parent.mkdir(parents=True, exist_ok=True)
        (kept / name).write_bytes(content)
    assert written(kept, copy.text).hash == far.hash


def test_describe_names_states_their_files_and_that_the_body_is_rigid(folder: Path) -> None:
    scene = written(folder, scene_text_of("pressed", "low"))
    text = describe(scene, sources(folder / "scene.toml")).text()
    assert "6 fibers x 3 states x 9 sites x 6 facets" in text
    assert "states.0.mesh" in text
    assert "skin moved aside by up to" in text
    assert "pixel for itself in every state" in text
    assert "lamps and camera stay where they are" in text
    (row,) = (line for line in text.splitlines() if "states.1.mesh" in line)
    assert row.endswith("simulation")


def test_meshes_of_another_topology_raise_one_clear_error_with_the_count(folder: Path) -> None:
    said = refused_body(folder, rest_body(15))
    assert "states.0.mesh" in said
    assert "odd.stl has 1020 triangles and rest.stl has 1152" in said
    # One corner drawn onto its neighbor: the same triangles, fewer corners.
    body = moved_body("low", 16)
    points = np.array(body.vertices)
    points[20] = points[21]
    said = refused_body(folder, trimesh.Trimesh(points, body.faces, process=False))
    assert "odd.stl" in said
    shuffled = rest_body(16)
    order = np.roll(np.arange(len(shuffled.faces)), 1)
    said = refused_body(
        folder, trimesh.Trimesh(shuffled.vertices, shuffled.faces[order], process=False)
    )
    assert "odd.stl joins other corners than rest.stl in" in said
    assert "allowed: the same triangles with moved corners" in said


def test_bodies_that_are_no_state_raise_one_clear_error(folder: Path) -> None:
    leaky = moved_body("pressed", 16)
    leaky.update_faces(np.arange(len(leaky.faces)) > 0)
    assert "odd.stl leaks: 3 of its edges do not join two triangles" in refused_body(folder, leaky)
    wide = moved_body("pressed", 16)
    wide.apply_scale([1.05, 1.0, 1.0])
    said = refused_body(folder, wide)
    assert "states: in odd skin.mesh is 21 x 24 mm, allowed: the pad's 20 x 24 mm" in said
    folded = rest_body(16)
    points = np.array(folded.vertices)
    upper = points[:, 2] > 0
    points[:, 0] = np.where(
        upper, points[:, 0] + 8.0 * np.exp(-((points[:, 0] / 2) ** 2)) * np.cos(points[:, 1] / 8),
        points[:, 0],
    )  # fmt: skip
    said = refused_body(folder, trimesh.Trimesh(points, folded.faces, process=False))
    assert "odd.stl folds: skin that is at" in said
    (folder / "odd.stl").write_bytes(b"nothing")
    assert "odd.stl is no body" in refusal(folder, scene_text_of("odd"))


def test_all_problems_of_all_states_are_told_at_once(folder: Path) -> None:
    rest_body(15).export(folder / "coarse.stl")
    leaky = moved_body("pressed", 16)
    leaky.update_faces(np.arange(len(leaky.faces)) > 0)
    leaky.export(folder / "leaky.stl")
    said = refusal(folder, scene_text_of("coarse", "leaky"))
    assert "states.0.mesh" in said
    assert "states.1.mesh" in said
    # Skin that sinks below lamps, and sites that are pushed together.
    sunk = rest_body(16)
    sunk.vertices = sunk.vertices * [1.0, 1.0, 0.35]
    sunk.export(folder / "sunk.stl")
    near = rest_body(16)
    points = np.array(near.vertices)
    x, y, z = points.T
    border = (1 - (x / 10) ** 2) * (1 - (y / 12) ** 2)
    points[:, 0] = np.where(z > 0, x * (1 - 0.75 * border), x)
    near = trimesh.Trimesh(points, near.faces, process=False)
    near.export(folder / "near.stl")
    said = refusal(folder, scene_text_of("sunk", "near"))
    assert "states: in sunk rows.0 at z = 1.5 mm lies above the skin" in said
    assert "states: in near sites" in said
    assert "so that pyramids overlap, allowed: at least 3 indenter.radius = 2.4 mm" in said


def test_lists_that_are_none_raise_one_clear_error(folder: Path) -> None:
    said = refusal(
        folder,
        scene_text_of("low", "low").replace("[0.0]", "[0.0, 30.0]"),
    )
    assert "states: the name low is there 2 times, allowed: once each" in said
    assert "states: bending.angles = 0, 30 deg, allowed beside states: 0 deg alone" in said
    said = refusal(folder, scene_text_of("low").replace('name = "low"', 'name = "rest"'))
    assert "states: the name rest is there 2 times, once for skin itself" in said
    flat = (
        scene_text("digit")
        + '\n[[states]]\nname = "low"\n'
        + ('radius = { value = 60.0, unit = "mm", source = "assumed" }\n')
    )
    assert "states: the skin is flat, allowed: with a [skin]; the states of a slab" in refusal(
        folder, flat
    )
    said = refusal(folder, scene_text_of("low").replace("schema = 2", "schema = 1"))
    assert "states needs schema = 2" in said
    assert "missing key states.0.mesh" in refusal(
        folder, scene_text_of(extra='[[states]]\nname = "none"\n')
    )
    text = round_scene_text() + scene_text_of("low")[scene_text_of("low").index("[[states]]") :]
    assert "states.0.mesh" in (said := refusal(folder, text))
    assert "it has no triangles to follow" in said
    assert "missing key states.0.radius" in refusal(
        folder, round_scene_text() + '[[states]]\nname = "none"\n'
    )
    text = scene_text_of("low") + 'thickness = { value = 5.0, unit = "mm", source = "assumed" }\n'
    assert "states.0.thickness: a mesh has its own, leave it out" in refusal(folder, text)


def test_states_of_one_shape_are_told_with_their_names(folder: Path) -> None:
    """Angles of bends must be distinct, too: what is there twice would count twice in S."""
    shutil.copy(folder / "low.stl", folder / "again.stl")
    said = refusal(folder, scene_text_of("low", "again", "pressed"))
    assert "states: low and again have one shape, allowed: distinct shapes" in said
    assert "pressed" not in said
    said = refusal(folder, scene_text_of("still").replace("still.stl", "rest.stl"))
    assert "states: rest and still have one shape" in said
    said = refusal(folder, round_scene_text(60.0, 40.0))
    assert "states: rest and r40 have one shape" in said
    assert "r60" not in said
    lower = round_scene_text(40.0, crown=5.5)
    assert written(folder, lower).state_names == ("rest", "r40")


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('"soft-dome"', '"Soft dome"', "name = Soft dome, allowed: 1 to 64 of a-z, 0-9, _ and -"),
        ('name = "low"', 'name = "-"', "states.0.name = -, allowed: 1 to 32 of a-z, 0-9, _ and -,"
                                       " the first a letter or a digit"),
    ],
)  # fmt: skip
def test_a_name_of_other_characters_raises_one_clear_error(
    folder: Path, old: str, new: str, sentence: str
) -> None:
    said = refusal(folder, scene_text_of("low").replace(old, new))
    assert sentence in said
    assert "pattern" not in said


def test_round_states_too_tight_for_the_pad_raise_one_clear_error(folder: Path) -> None:
    said = refusal(folder, round_scene_text(60.0, 12.0, crown=5.0))
    assert "states: in r12 skin.radius = 12 mm is too tight" in said
    assert "r60" not in said
    scene = written(folder, round_scene_text(60.0, crown=5.0))
    assert scene.pad.thickness == CROWN
    assert scene.in_state(1.0).pad.thickness == 5.0


def test_files_cannot_carry_sites_themselves(folder: Path) -> None:
    carried = "sites.carried = { x = [0.0], y = [0.0], turn = [0.0] }\nsites.columns = 3"
    text = scene_text_of().replace("sites.columns = 3", carried)
    assert "no scene file has this key" in refusal(folder, text)
    schema = json.dumps(scene_schema())
    assert "carried" not in schema
    assert '"states"' in schema


def test_the_page_shows_scenes_that_load(folder: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "scenes.md").read_text()
    blocks = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    mesh, dome = (block for block in blocks if "[[states]]" in block)
    shutil.copy(folder / "rest.stl", folder / "gel.stl")
    body = "\n".join(line for line in scene_text_of().splitlines() if not line.startswith("skin ="))
    scene = written(folder, f"{body}\n{mesh}")
    assert scene.state_names == ("rest", "pressed", "twisted")
    assert scene.in_state(2.0).sites.turns.any()
    scene = written(folder, f"{body}\n{dome}")
    assert scene.state_names == ("rest", "flattened")
    assert scene.in_state(1.0).pad.thickness == 5.2


def test_a_refused_skin_is_told_once_and_not_again_for_each_of_its_states(folder: Path) -> None:
    aside = rest_body(16)
    aside.apply_translation([1.0, 0.0, 0.0])
    aside.export(folder / "aside.stl")
    trimesh.creation.cylinder(radius=6.0, height=6.0).export(folder / "coin.stl")
    for name, sentence in (
        ("aside", "aside.stl has its middle 1 mm beside the origin"),
        ("absent", "absent.stl is no body: there is no such file"),
        ("coin", "the upper side ends within the outline"),
    ):
        said = refusal(folder, scene_text_of("pressed", "low", mesh=f"{name}.stl"))
        assert said.count(sentence) == 1
        assert "states" not in said
    # What is wrong with a state itself is told all the same.
    leaky = moved_body("pressed", 16)
    leaky.update_faces(np.arange(len(leaky.faces)) > 0)
    leaky.export(folder / "leaky.stl")
    said = refusal(folder, scene_text_of("pressed", "leaky", mesh="aside.stl"))
    assert "states.1.mesh" in said
    assert "states.0" not in said
