"""Sites count where the camera sees them whole; the others are counted, named and left out."""

from __future__ import annotations

import re

import numpy as np
import pytest

from render.errors import SceneError
from render.geometry import (
    aim_at,
    camera_coverage,
    camera_origin,
    check_seen,
    counted_sites,
    declared_sites,
    facet_masks,
    facets,
    flat_sites,
    is_mirror_symmetric,
    mirror_image,
    seen_targets,
)
from render.scene import Scene, load_scene, unchecked

FULL = load_scene("finger20")
BENDS = np.radians([0.0, 45.0, 90.0])


def changed(scene: Scene, **parts: dict[str, object]) -> Scene:
    """Return ``scene`` with other values in some of its parts."""
    update = {name: unchecked(getattr(scene, name), new) for name, new in parts.items()}
    return unchecked(scene, update)


SCENE = changed(FULL, camera={"columns": 120, "rows": 200})
NARROW = changed(SCENE, camera={"field_of_view": np.radians(52.6)}, bending={"angles": (0.0, 1.2)})
COARSE = changed(SCENE, camera={"columns": 60, "rows": 100})


@pytest.mark.parametrize("scene", [SCENE, NARROW, COARSE])
@pytest.mark.parametrize("bend", [0.0, 0.8])
def test_a_target_is_seen_where_its_mask_has_a_pixel(scene: Scene, bend: float) -> None:
    np.testing.assert_array_equal(seen_targets(scene, bend), facet_masks(scene, bend).counts > 0)


def test_all_sites_of_the_default_finger_count() -> None:
    assert counted_sites(FULL).tolist() == list(range(15))
    assert camera_coverage(FULL).sentence == (
        "15 of 15 sites count, and 450 of 450 facets are seen (over 3 bends)"
    )


def test_a_site_counts_that_is_whole_at_every_bend() -> None:
    whole = [(facet_masks(NARROW, bend).counts > 0).all(axis=1) for bend in (0.0, 1.2)]
    assert (whole[0] != whole[1]).any()
    wanted = np.nonzero(whole[0] & whole[1])[0]
    assert 0 < len(wanted) < 15
    np.testing.assert_array_equal(counted_sites(NARROW), wanted)
    np.testing.assert_array_equal(flat_sites(NARROW), declared_sites(NARROW)[wanted])


def test_facets_that_are_not_seen_are_counted_by_cause() -> None:
    coverage = camera_coverage(NARROW)
    assert sum(coverage.unseen.values()) == (~coverage.seen[..., :-1]).sum()
    assert coverage.unseen["outside the picture"] > 0
    assert "sites left out: 0, 1, 2" in coverage.sentence
    coarse = camera_coverage(COARSE)
    assert coarse.unseen["smaller than a pixel"] == sum(coarse.unseen.values()) > 0
    steep = changed(
        SCENE, indenter={"slope": np.radians(75.0), "radius": 0.5}, bending={"angles": (0.0,)}
    )
    assert camera_coverage(steep).unseen["hidden"] > 0


@pytest.mark.parametrize(
    ("parts", "sentence"),
    [
        (
            {"camera": {"field_of_view": np.radians(2.0), "y": 4.5}},
            r"field_of_view = 2 deg to \d+ deg",
        ),
        (
            {"camera": {"columns": 24, "rows": 40}},
            r"camera.columns = 24 and camera.rows = 40 to \d+ and \d+",
        ),
        (
            {"camera": {"y": 500.0}, "bending": {"angles": (0.0,)}},
            r"0 of 150 facets \(150 outside the picture\).*: it stands at \(0, 500, -10\) mm and "
            r"looks along \(0, 0, 1\), the sites lie about \(0, 3, 4\) mm: turn or move the camera",
        ),
        (
            {
                "indenter": {"slope": np.radians(75.0), "radius": 0.6},
                "camera": {"columns": 720, "rows": 1200, "y": -14.0, "field_of_view": 2.4},
                "bending": {"angles": (0.0,)},
            },
            r"\d+ hidden.*lower indenter.slope = 75 deg to \d+ deg",
        ),
    ],
)
def test_a_camera_that_sees_no_site_whole_raises_one_clear_error(
    parts: dict[str, dict[str, object]], sentence: str
) -> None:
    with pytest.raises(SceneError, match=sentence) as caught:
        flat_sites(changed(SCENE, **parts))
    assert "\n" not in str(caught.value)


def test_the_field_of_view_that_an_error_names_is_enough() -> None:
    blind = changed(SCENE, camera={"field_of_view": np.radians(2.0), "y": 4.5})
    with pytest.raises(SceneError) as caught:
        counted_sites(blind)
    wider = float(str(caught.value).split("deg to ")[1].split(" deg")[0])
    assert len(counted_sites(changed(blind, camera={"field_of_view": np.radians(wider)}))) == 15
    less = changed(blind, camera={"field_of_view": np.radians(wider - 5.0)})
    assert len(camera_coverage(less).counted) < 15


@pytest.mark.parametrize(
    "parts",
    [
        {"camera": {"columns": 24, "rows": 40}},
        {
            "indenter": {"slope": np.radians(75.0), "radius": 0.6},
            "camera": {"columns": 720, "rows": 1200, "y": -14.0, "field_of_view": 2.4},
            "bending": {"angles": (0.0,)},
        },
    ],
)
def test_the_pixels_and_the_slope_that_an_error_names_are_enough(
    parts: dict[str, dict[str, object]],
) -> None:
    blind = changed(SCENE, **parts)
    with pytest.raises(SceneError) as caught:
        counted_sites(blind)
    named = [float(number) for number in re.findall(r"[\d.]+", str(caught.value).split(" to ")[-1])]
    better: dict[str, object] = {"slope": np.radians(named[0])}
    part = "indenter"
    if len(named) == 2:
        part, better = "camera", {"columns": int(named[0]), "rows": int(named[1])}
    assert len(counted_sites(changed(blind, **{part: better})))


def test_a_bend_of_its_own_is_checked_before_anything_is_rendered() -> None:
    bent = changed(NARROW, bending={"angles": (1.2,)})
    check_seen(bent, np.array([1.2, 1.201]))
    with pytest.raises(SceneError, match=r"at a bend of 0 deg, the first of site 0"):
        check_seen(bent, np.array([1.2, 0.0]))


@pytest.mark.parametrize("bend", BENDS)
def test_refraction_leads_a_line_of_sight_to_what_it_was_aimed_at(bend: float) -> None:
    points = facets(SCENE, bend).centroid.reshape(-1, 3)
    direction, reached = aim_at(SCENE, bend, camera_origin(SCENE), points)
    assert reached.all()
    # Snell's law by the stationarity of the optical path: moving the entry point costs nothing.
    origin, index = camera_origin(SCENE), SCENE.pad.index
    if bend == 0.0:
        entry = origin + direction * (-origin[2] / direction[:, 2:])
        for axis in (0, 1):
            step = 1e-4 * np.eye(3)[axis]
            lengths = [
                np.linalg.norm(entry + s * step - origin, axis=1)
                + index * np.linalg.norm(points - entry - s * step, axis=1)
                for s in (-1, 1)
            ]
            np.testing.assert_allclose(lengths[0], lengths[1], atol=1e-8)


def test_the_mirror_maps_sites_that_count_onto_each_other() -> None:
    centers = flat_sites(NARROW)
    phi = np.full((20, 1), np.pi / 2)
    assert is_mirror_symmetric(NARROW, phi)
    values = np.broadcast_to(centers[:, 0], (20, 1, 1, len(centers)))
    np.testing.assert_allclose(mirror_image(NARROW, values, facets=False), -values)
    heights = np.broadcast_to(centers[:, 1], (20, 1, 1, len(centers)))
    np.testing.assert_allclose(mirror_image(NARROW, heights, facets=False), heights)
