"""States of a skin at level 0: each is the sensor whose skin stays so, bit for bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from render.errors import GraphicsError, SceneError
from render.geometry import (
    ball,
    camera_origin,
    camera_rays,
    declared_sites,
    in_state,
    refract_into_pad,
)
from render.geometry.visibility import first_facet
from render.preview import Preview
from render.scene import Scene
from tests.oracles.soft_domes import CROWN, LOW, scene_text_of, write_files, written

AHEAD = np.array([np.pi / 2])
PHI, POWER = np.full(6, np.pi / 2), np.eye(3)[[0, 0, 1, 1, 2, 2]]
SIZE = 80, 100


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dome")
    write_files(folder)
    return folder


@pytest.fixture(scope="module")
def scene(folder: Path) -> Scene:
    return written(folder, scene_text_of("low", "twisted"))


@pytest.mark.slow
def test_every_state_has_the_light_of_a_plain_scene_of_its_mesh(scene: Scene, folder: Path) -> None:
    states = np.array(scene.state_axis)
    with Preview(scene) as preview:
        drawn = preview.transport(AHEAD, states)
        skin = preview.skin(AHEAD, states[1:2])
        # Drawn in turns, each in its own context.
        pictures = [preview.picture(PHI, POWER, state, *SIZE) for state in scene.state_axis]
        sight = preview.sight(2.0, *SIZE)
        again = preview.transport(AHEAD, states[::-1])
    np.testing.assert_array_equal(again[0][:, :, ::-1], drawn[0])
    plain = (
        written(folder, scene_text_of()),
        written(folder, scene_text_of(mesh="low.stl", crown=CROWN * LOW)),
    )
    for number, one in enumerate((*plain, in_state(scene, 2.0)[0])):
        with Preview(one) as preview:
            alone = preview.transport(AHEAD, np.zeros(1))
            picture = preview.picture(PHI, POWER, 0.0, *SIZE)
            if number == 1:
                np.testing.assert_array_equal(preview.skin(AHEAD, np.zeros(1)), skin)
        assert picture.max() > 0.0
        np.testing.assert_array_equal(pictures[number], picture)
        for part, same in zip(alone, drawn, strict=True):
            np.testing.assert_array_equal(part[:, :, 0], same[:, :, number])
    assert np.abs(drawn[0][:, :, 2] / drawn[0][:, :, 0] - 1.0).max() > 0.05
    assert sight.scene.name == "soft-dome-twisted"


def test_pixels_see_the_facets_of_sites_where_the_skin_has_carried_them(scene: Scene) -> None:
    one, bend = in_state(scene, 2.0)
    assert np.abs(one.sites.places - scene.sites.places).max() > 0.2
    columns, rows = 160, 200
    with Preview(one) as preview:
        sight = preview.sight(bend, columns, rows)
    directions = camera_rays(one, columns, rows)[1].reshape(-1, 3)
    rays = refract_into_pad(one, bend, camera_origin(one), directions)
    faces = one.indenter.faces
    # The camera looks from within, pictures are drawn from outside.
    met = first_facet(one, bend, rays, 0.0).reshape(rows, columns)[::-1, ::-1]
    met = met.ravel()[sight.pixel]
    seen = np.where(sight.facet < 0, -1, sight.site * (faces + 1) + sight.facet)
    # Pixels whose middle lies within rounding of a facet's edge may differ.
    assert (seen == met).mean() > 0.995
    assert set(np.unique(sight.site[sight.facet >= 0])) == set(range(9))


def test_two_previews_draw_their_pictures_in_turns(folder: Path) -> None:
    plain = written(folder, scene_text_of())
    with Preview(plain) as first, Preview(plain) as second:
        pictures = [one.picture(PHI, POWER, 0.0, *SIZE) for one in (first, second, first)]
    assert pictures[0].max() > 0.0
    np.testing.assert_array_equal(pictures[1], pictures[0])
    np.testing.assert_array_equal(pictures[2], pictures[0])


def test_bodies_are_pressed_into_the_sensor_of_one_state(scene: Scene) -> None:
    with pytest.raises(GraphicsError, match="has states, and what is pressed in stands on"):
        Preview(scene, imprint=ball(scene))
    one, bend = in_state(scene, 1.0)
    body = ball(one)
    assert body.center[0, 2] < ball(in_state(scene, 0.0)[0]).center[0, 2]
    with Preview(one, imprint=body) as preview:
        assert preview.picture(PHI, POWER, bend, *SIZE).max() > 0.0
    assert np.isfinite(declared_sites(one)).all()


def test_states_that_are_none_raise_one_clear_error(scene: Scene) -> None:
    with Preview(scene) as preview:
        with pytest.raises(SceneError, match=r"state 0.5 of soft-dome, allowed: .*rest, low"):
            preview.transport(AHEAD, np.array([0.0, 0.5]))
        with pytest.raises(GraphicsError, match="ask for one state at a time"):
            preview.skin(AHEAD, np.array(scene.state_axis))
