"""Mitsuba's gallery by ``bdpt``, in rgb: each of its plugins is right, or refused by a sentence.

``python -m pytest tests/validation/test_gallery.py -s`` prints the table: the ratio of our mean to
that of Mitsuba's own integrator with its error bar, or the sentence. Plugins are those of the
installed Mitsuba: one that no row has fails the last test.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from render.errors import RenderError
from tests.validation import gallery
from tests.validation.film import LONG, check_same, ours, relative_bar, theirs
from tests.validation.gallery import CAMERAS, FORMATS, SINGLE_CAMERAS, board, cells, view
from tests.validation.refused_gallery import NOT_OBJECTS, REFERENCES, UNREACHED, refused

SPP = 16384 if LONG else 1024
BOARDS = {
    "surfaces": ("volpath", SPP // 2), "media": ("volpath", SPP), "lamps": ("volpath", SPP)
}  # fmt: skip
DEVIATIONS_MAX, BAR_MAX = 4.5, 0.03


@pytest.fixture(scope="module")
def rgb() -> ModuleType:
    from render.reference import mitsuba

    return mitsuba("llvm_ad_rgb")


@pytest.fixture(scope="module")
def table() -> Iterator[dict[str, str]]:
    """Return the rows, what is tried -> what came out, to be printed in the end."""
    rows: dict[str, str] = {}
    yield rows
    print("\n\n" + "\n".join(f"| {name} | {verdict} |" for name, verdict in rows.items()))


def right(images: np.ndarray, truth: np.ndarray, against: str) -> str:
    """Return the verdict on a ratio of means of runs, and fail where it is not 1."""
    ratio = images.mean() / truth.mean()
    bar = np.hypot(*(x.std(ddof=1) / np.sqrt(len(x)) / x.mean() for x in (images, truth)))
    verdict = f"{ratio:.4f} +- {bar:.4f} of {against}"
    assert bar < BAR_MAX, verdict
    assert abs(ratio - 1.0) < DEVIATIONS_MAX * bar, verdict
    return verdict


@pytest.mark.parametrize("name", BOARDS)
def test_every_cell_of_a_board_has_the_light_that_mitsuba_finds(
    rgb: ModuleType, name: str, tmp_path: Path, table: dict[str, str]
) -> None:
    parts = getattr(gallery, name)(rgb, tmp_path)
    scene = board(rgb, parts, light=name != "lamps")
    against, spp = BOARDS[name]
    images = cells(ours(rgb, scene, "bdpt", spp), len(parts))
    truth = cells(theirs(rgb, scene, against, spp // 2), len(parts))
    for k, part in enumerate(parts):
        table[part] = right(images[:, k], truth[:, k], against)


SKIES = ("emitter directional", "emitter constant", "emitter envmap")


def sky(rgb: ModuleType, name: str) -> dict[str, Any]:
    if name == "emitter directional":
        return {"type": "directional", "direction": [0.3, 0.4, -1], "irradiance": 2.0}
    if name == "emitter constant":
        return {"type": "constant", "radiance": {"type": "rgb", "value": [0.3, 0.5, 0.8]}}
    pixels = (3 * np.random.default_rng(1).random((8, 16, 3)) ** 4 + 0.1).astype(np.float32)
    return {"type": "envmap", "bitmap": rgb.Bitmap(pixels), "scale": 0.5}


@pytest.mark.parametrize("names", [(n,) for n in SKIES] if LONG else [(SKIES[0], SKIES[2])])
def test_light_from_afar_is_as_mitsuba_finds_it(
    rgb: ModuleType, names: tuple[str, ...], table: dict[str, str]
) -> None:
    # One environment at a time.
    lights = {"sun" if name == SKIES[0] else "sky": sky(rgb, name) for name in names}
    scene = view(rgb, {}, {}, **lights)
    verdict = compared(rgb, scene, "path", " and ".join(names))
    table |= dict.fromkeys(names, verdict)


def compared(rgb: ModuleType, scene: Any, against: str, what: str, kind: str = "bdpt") -> str:
    """Return the verdict on a picture, of which all blocks have to be as by Mitsuba."""
    images, truth = ours(rgb, scene, kind, SPP), theirs(rgb, scene, against, SPP // 2)
    check_same(images, truth, what)
    bar = np.hypot(relative_bar(images), relative_bar(truth))
    return f"{images.mean() / truth.mean():.4f} +- {bar:.4f} of {against}"


@pytest.mark.parametrize("name", CAMERAS | SINGLE_CAMERAS if LONG else CAMERAS)
def test_a_camera_and_its_film_see_what_they_see_in_path(
    rgb: ModuleType, name: str, table: dict[str, str]
) -> None:
    # Optimized: both cubes become one mesh.
    scene = view(rgb, *(CAMERAS | SINGLE_CAMERAS)[name], optimize=True)
    assert any(shape.class_name() == "Mesh" for shape in scene.shapes())
    table[name] = table["shape mi.Mesh"] = compared(rgb, scene, "path", name)
    if LONG:
        compared(rgb, scene, "ptracer", f"{name}, ptracer")
        compared(rgb, scene, "path", f"{name}, pssmlt", kind="pssmlt")


@pytest.mark.parametrize("name", FORMATS if LONG else ["luminance", "xyz", "pfm"])
def test_after_a_render_the_film_holds_the_picture_in_its_format(
    rgb: ModuleType, name: str, tmp_path: Path, table: dict[str, str]
) -> None:
    scene = view(rgb, {}, {"width": 4, "height": 4} | FORMATS[name])
    film, held = scene.sensors()[0].film(), {}
    for kind in ("path", "bdpt"):
        integrator = rgb.load_dict({"type": kind})
        runs = []
        for seed in range(1, 5):
            picture = np.array(rgb.render(scene, integrator=integrator, spp=1024, seed=seed))
            bitmap = np.array(film.bitmap()).reshape(picture.shape)
            np.testing.assert_allclose(bitmap, picture, rtol=1e-5)
            runs.append(bitmap)
        held[kind] = np.stack(runs)
        film.write(str(tmp_path / f"{kind}.exr"))
    assert held["bdpt"].shape == held["path"].shape
    means = {kind: runs.mean(axis=(1, 2)) for kind, runs in held.items()}
    for channel in range(means["path"].shape[-1]):
        verdict = right(means["bdpt"][:, channel], means["path"][:, channel], "path")
    table[f"film hdrfilm, {name}"] = verdict
    if name != "uint32":  # a radiance below 1 is 0 there
        files = {kind: next(tmp_path.glob(f"{kind}.*")) for kind in held}
        ratio = np.divide(*(np.array(rgb.Bitmap(str(files[k]))).mean() for k in ("bdpt", "path")))
        assert ratio == pytest.approx(1.0, abs=0.05)


SAMPLERS = ("independent", "stratified", "multijitter", "orthogonal", "ldsampler")


def test_the_sampler_of_a_scene_changes_nothing_but_the_number_of_samples(
    rgb: ModuleType, table: dict[str, str]
) -> None:
    integrator = rgb.load_dict({"type": "bdpt"})
    pictures = {}
    for name in SAMPLERS if LONG else SAMPLERS[:2]:
        scene = view(rgb, {"sampler": {"type": name, "sample_count": 4}}, {})
        pictures[name] = np.array(rgb.render(scene, integrator=integrator))
        np.testing.assert_array_equal(pictures[name], pictures["independent"])
        table[f"sampler {name}"] = "bit-equal to independent"


@pytest.mark.parametrize("name", refused())
def test_what_is_not_rendered_as_mitsuba_does_is_refused_in_a_sentence(
    rgb: ModuleType, name: str, table: dict[str, str]
) -> None:
    make, named = refused()[name]
    scene, integrator = make(rgb)
    with pytest.raises(RenderError, match=named) as caught:
        rgb.render(scene, integrator=rgb.load_dict(integrator), spp=1)
    table[name] = f"refused: {caught.value}"


def plugins(rgb: ModuleType) -> set[tuple[str, str]]:
    """Return kind and name of every plugin of the installed Mitsuba."""
    manager, found = rgb.PluginManager.instance(), set()
    kinds = {"reconstructionfilter": "rfilter", "phasefunction": "phase"}
    for path in (Path(rgb.__file__).parent / "plugins").glob("*.so"):
        kind = str(manager.plugin_type(path.stem)).rpartition(".")[2].lower()
        found.add((kinds.get(kind, kind), path.stem))
    return found


def test_every_plugin_of_the_installed_mitsuba_is_right_or_refused(
    rgb: ModuleType, tmp_path: Path
) -> None:
    from render.integrators.supported_plugins import PLUGINS

    names = [*CAMERAS, *SINGLE_CAMERAS, *SKIES, *(f"sampler {name}" for name in SAMPLERS)]
    for name in BOARDS:
        names += getattr(gallery, name)(rgb, tmp_path)
    rows = {tuple(name.partition(",")[0].split(" ")) for name in names}
    # What these are part of is on the boards.
    rows |= {("medium", "homogeneous"), ("film", "hdrfilm"), ("shape", "shapegroup")}
    rows |= {("volume", "gridvolume"), ("volume", "constvolume"), ("shape", "mi.Mesh")}
    supported = {(kind, name) for kind, listed in PLUGINS.items() for name in listed}
    assert supported == rows
    others = {tuple(name.partition(",")[0].split(" ")) for name in refused()}
    others |= set(UNREACHED) | NOT_OBJECTS | REFERENCES
    assert plugins(rgb) - rows - others == set()
    # Nothing is both.
    assert not supported & (set(UNREACHED) | NOT_OBJECTS | REFERENCES)
