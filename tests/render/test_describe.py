"""A description lists every value with its unit and source, and what is left out."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np

from render.describe import describe
from render.scene import Scene, load_scene, sources, unchecked
from tests.oracles.pads import scene_of_case

SCENE = load_scene("finger20")


def left_out(scene: Scene) -> dict[str, str]:
    return {item.what: item.why for item in describe(scene).left_out}


def changed(part: str, **values: object) -> Scene:
    return unchecked(SCENE, {part: unchecked(getattr(SCENE, part), values)})


def test_every_value_of_the_file_is_listed_with_its_unit_and_source() -> None:
    origins = sources("finger20")
    values = {item.key: item for item in describe(SCENE, origins).values}
    assert set(origins) <= set(values)
    for key, source in origins.items():
        assert values[key].source == source
    assert values["pad.width"].value == 18.0
    assert values["pad.width"].unit == values["camera.distance"].unit == "mm"
    assert values["fibers.left"].value == 8


def test_angles_are_given_in_degrees_as_in_the_file() -> None:
    values = {item.key: item for item in describe(SCENE).values}
    assert values["fibers.sigma_v"].value == 15.0
    assert values["bending.angles"].value == (0.0, 45.0, 90.0)
    assert values["bending.angles"].unit == "deg"


def test_cells_are_counted_per_direction_node() -> None:
    description = describe(SCENE)
    assert description.axes == {"fiber": 20, "bend": 3, "site": 15, "facet": 10}
    assert description.cells == 9000
    assert description.background_cells == 900


def test_the_default_finger_leaves_out_no_medium() -> None:
    assert "scattering medium" not in left_out(SCENE)
    assert "other shapes of the skin" not in left_out(SCENE)
    assert "Lambertian" in left_out(SCENE)["specular lobe of the coating"]


def test_a_bare_flat_scene_leaves_out_medium_and_other_shapes() -> None:
    bare = unchecked(SCENE, {"diffuser": None})
    assert "no diffuser" in left_out(bare)["scattering medium"]
    assert not any(item.key.startswith("diffuser") for item in describe(bare).values)
    assert "other shapes of the skin" in left_out(changed("bending", angles=(0.0,)))
    assert "rough refraction" in left_out(changed("pad", roughness=0.0))
    assert "light from the tip edge" in left_out(changed("fibers", tip=0))


def test_an_edge_that_a_listed_lamp_stands_before_is_not_left_out() -> None:
    """Two lamps of a DIGIT are listed before its base, and none stands at its sides."""
    out = left_out(load_scene("digit"))
    assert "light from the base edge" not in out
    assert out["light from the left edge"] == "no lamp stands before it"


def test_a_sensor_of_one_shape_is_told_without_a_word_of_bends_or_states() -> None:
    one = changed("bending", angles=(0.0,))
    text = describe(one).text()
    assert "20 fibers x 15 sites x 10 facets = 3000" in text
    assert "150 of 150 facets are seen (a site counts where each of its facets and its " in text
    assert "has a pixel for itself)" in text
    other = [line for line in text.splitlines() if not line.startswith("  bending.angles ")]
    assert not re.search(r"\b(bend|state)", "\n".join(other))
    assert describe(one).axes["bend"] == 1  # of the transport all the same


def test_axes_are_told_in_the_right_number() -> None:
    lonely = replace(describe(SCENE), axes={"fiber": 1, "bend": 3, "site": 1, "facet": 10})
    assert "1 fiber x 3 bends x 1 site x 10 facets" in lonely.text()
    named = replace(describe(SCENE), axes={"fiber": 1, "state": 2, "site": 3, "facet": 10})
    assert "1 fiber x 2 states x 3 sites x 10 facets" in named.text()
    assert "has a pixel for itself in every state)" in named.text()


def test_text_and_json_hold_the_same_values() -> None:
    description = describe(SCENE, sources("finger20"))
    text = description.text()
    parsed = json.loads(json.dumps(description.to_json()))
    assert parsed["scene_hash"] == SCENE.hash
    for item in parsed["values"]:
        assert item["key"] in text
        assert item["source"] in text
    for item in parsed["left_out"]:
        assert f"{item['what']}: {item['why']}" in text
    assert "0, 45, 90 deg" in text
    assert np.isclose(parsed["cells"], 9000)


def test_faces_are_listed_and_only_what_no_face_is_is_left_out() -> None:
    scene = scene_of_case("rough left and lower, smooth tip")
    values = {item.key: item.value for item in describe(scene).values}
    assert values["faces.0.on"] == ("tip", "base")
    assert values["faces.1.roughness"] == 0.05
    assert "rough refraction" not in left_out(scene)
    assert "rough refraction" in left_out(scene_of_case("smooth"))
    painted = scene_of_case("white, mirror and black walls")
    values = {item.key: item.value for item in describe(painted).values}
    assert values["faces.0.white"] == 0.9
    assert values["faces.2.black"] is True
    assert "faces.2.white" not in values
    assert "rough refraction" in left_out(painted)
    assert "rough refraction" not in left_out(scene_of_case("mirror walls rough 0.1"))


def test_what_the_preview_leaves_out_of_painted_edges_is_told_where_the_pad_bends() -> None:
    def told(case: str) -> bool:
        return any(
            "painted edges of the bent pad" in what for what in left_out(scene_of_case(case))
        )

    assert told("white walls bent 45")
    assert told("mirror walls bent 45")
    assert not told("rough edges bent 45")
    assert not told("white, mirror and black walls")


def test_lamps_that_hardly_light_the_pad_or_stand_beside_it_are_told_of() -> None:
    assert describe(SCENE).doubts == ()
    past = changed("fibers", tilt=np.radians(60.0), sigma_v=np.radians(5.0), gap=9.0, height=4.0)
    first, *_ = describe(past).doubts
    assert first.startswith("of the light of lamp 0 (fibers.left) 0.0% meets the silicone in its")
    assert "worth a second look:" in describe(past).text()
    half = changed("fibers", height=0.0)
    assert describe(half).doubts[0] == (
        "of the end of lamp 0 (fibers.left) 50% stands before the left face, the rest beside it: "
        "is that meant?"
    )
