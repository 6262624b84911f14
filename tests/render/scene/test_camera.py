"""The camera of a scene file: any pose, one hash for one camera, and one sentence per mistake."""

from __future__ import annotations

from pathlib import Path

import pytest

from render.errors import SceneError
from render.scene import Scene, load_scene, scene_content, scene_of, sources

TEXT = (Path(__file__).parents[3] / "render" / "scenes" / "finger20.toml").read_text()
OLD = """distance = { value = 10.0, unit = "mm", source = "assumed" }
y = { value = 3.0, unit = "mm", source = "assumed: nearer the tip, thesis 4.1" }
"""
POSE = """position = { value = [0.0, 3.0, -10.0], unit = "mm", source = "CAD" }
"""
LOOK = 'look_at = { value = [0.0, 3.0, 4.0], unit = "mm", source = "CAD" }\n'


def loaded(folder: Path, camera: str, schema: int = 2, old: str = OLD) -> Scene:
    assert old in TEXT
    text = TEXT.replace(old, camera, 1).replace("schema = 1", f"schema = {schema}", 1)
    path = folder / "scene.toml"
    path.write_text(text)
    return load_scene(path)


def refusal(folder: Path, camera: str, schema: int = 2) -> str:
    with pytest.raises(SceneError) as caught:
        loaded(folder, camera, schema)
    return str(caught.value)


@pytest.mark.parametrize(
    "words",
    [
        OLD,
        POSE,
        POSE + LOOK + 'lens = "pinhole"\n',
        OLD + 'direction = { value = [0.0, 0.0, 3.0], source = "CAD" }\n',
        POSE + 'up = { value = [0.0, 2.0, 1.0], source = "CAD" }\n',
    ],
)
def test_one_camera_in_other_words_has_one_hash(tmp_path: Path, words: str) -> None:
    scene = loaded(tmp_path, words)
    assert scene.hash == "68471ad4c129ea4d"
    assert scene_of(scene_content(scene)).camera.axes == scene.camera.axes


def test_another_pose_or_lens_is_another_scene_and_travels_as_it_is(tmp_path: Path) -> None:
    words = [
        POSE.replace("[0.0", "[0.5"),
        POSE + LOOK.replace("[0.0", "[1.0"),
        POSE + 'up = { value = [1.0, 1.0, 0.0], source = "CAD" }\n',
        OLD + 'lens = "fisheye"\n',
    ]
    scenes = [loaded(tmp_path, word) for word in words]
    assert len({scene.hash for scene in scenes} | {"68471ad4c129ea4d"}) == 5
    for scene in scenes:
        there = scene_of(scene_content(scene))
        assert there.hash == scene.hash
        assert (there.camera.place, there.camera.axes) == (scene.camera.place, scene.camera.axes)
        assert there.camera.fisheye == scene.camera.fisheye
    assert sources(tmp_path / "scene.toml")["camera.distance"] == "assumed"


@pytest.mark.parametrize(
    ("camera", "sentence"),
    [
        ("", "missing key camera.distance"),
        (OLD + POSE, "camera.distance and camera.position both place the camera"),
        (POSE.replace("-10.0]", "2.0]"), "z = 2 mm, which is not below the pad, allowed: below 0"),
        (POSE.replace(", -10.0]", "]"), "camera.position has 2 values, allowed: 3 (x, y, z)"),
        (POSE + LOOK.replace("4.0]", "-10.0]"), "camera.look_at is camera.position"),
        (POSE + 'direction = { value = [0, 0, 0.0], source = "CAD" }\n', "camera.direction"),
        (
            POSE + LOOK + 'direction = { value = [0.0, 0.0, 1.0], source = "CAD" }\n',
            "look_at and camera.direction both turn",
        ),
        (
            POSE + 'up = { value = [0.0, 0.0, 1.0], source = "CAD" }\n',
            "camera.up = (0, 0, 1) lies along the way that the camera looks, (0, 0, 1)",
        ),
        (POSE.replace("3.0, -10.0", "nan, -10.0"), "camera.position"),
        (POSE + 'lens = "mirror"\n', 'camera.lens = "mirror", allowed: "pinhole" or "fisheye"'),
    ],
)
def test_a_mistake_in_the_camera_is_one_sentence(
    tmp_path: Path, camera: str, sentence: str
) -> None:
    assert sentence in refusal(tmp_path, camera)


def test_a_file_of_schema_1_names_no_pose(tmp_path: Path) -> None:
    text = refusal(tmp_path, OLD + LOOK + 'lens = "fisheye"\n', schema=1)
    assert "camera.look_at needs schema = 2" in text
    assert "camera.lens needs schema = 2" in text


def test_the_widest_view_depends_on_the_lens(tmp_path: Path) -> None:
    wide = 'field_of_view = { value = 200.0, unit = "deg", source = "CAD" }\n'
    old = 'field_of_view = { value = 110.0, unit = "deg", source = "assumed: 160 deg lens, cut to'
    old += ' the pad" }\n'
    with pytest.raises(SceneError, match=r"= 200 deg, allowed: 1 to 175 deg for a pinhole"):
        loaded(tmp_path, wide, old=old)
    assert loaded(tmp_path, wide + 'lens = "fisheye"\n', old=old).camera.fisheye
    too_wide = wide.replace("200.0", "299.9") + 'lens = "fisheye"\ncolumns = 600\n'
    with pytest.raises(SceneError, match=r"deg from the axis, allowed: at most 247\.5 deg"):
        loaded(tmp_path, too_wide, old=old + "columns = 360\n")


def test_what_a_camera_makes_of_its_light_leaves_the_hash_and_travels_with_the_scene(
    tmp_path: Path,
) -> None:
    noisy = OLD + (
        'read_noise = { value = 2.0, unit = "counts", source = "data sheet" }\n'
        'gains = { value = [1.0, 4.0], source = "driver" }\nbits = 10\n'
    )
    plain, scene = loaded(tmp_path, OLD), loaded(tmp_path, noisy)
    assert scene.hash == plain.hash
    assert (scene.camera.read_noise, scene.camera.gains, scene.camera.bits) == (2.0, (1.0, 4.0), 10)
    assert scene_of(scene_content(scene)).camera == scene.camera


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ('read_noise = { value = -1.0, unit = "counts", source = "x" }\n', "camera.read_noise"),
        ('full_well = { value = 5.0, unit = "electrons", source = "x" }\n', "camera.full_well"),
        ("bits = 40\n", "camera.bits"),
        ('gains = { value = [0.5], source = "x" }\n', "camera.gains"),
    ],
)
def test_a_camera_that_no_one_has_is_one_sentence(tmp_path: Path, words: str, said: str) -> None:
    text = refusal(tmp_path, OLD + words)
    assert said in text
    assert "allowed: " in text
