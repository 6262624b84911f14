"""Design the lighting of vision-based tactile sensors: the public API of tactilux.

Everything that programs and notebooks may rely on is here; what lies inside the packages may move.
Lengths in mm, angles in rad, powers as fractions of full power. Arrays are float64 numpy arrays;
transport has the axes ``(fiber, phi_node, bend, site, facet)``, radiance at the camera in
1/(mm^2 sr) per unit power of one fiber. Wrong input raises a `TactiluxError` that names the field,
the value and what is allowed.

>>> import numpy as np, tactilux
>>> scene = tactilux.load_scene("finger20")
>>> scene.lamp_count, scene.sites.count, scene.indenter.faces
(20, 15, 10)
>>> baseline = tactilux.baseline_design(scene)
>>> baseline.color_names[:2], float(np.degrees(baseline.phi[0]))
(['red', 'red'], 90.0)
>>> checker = tactilux.load_model(scene)
>>> bends = np.array(scene.state_axis)  # rad, or numbers of states
>>> said = checker.run(baseline.phi[None], baseline.power[None], bends)
>>> said["counts"].shape  # (design, bend, site, facet, channel)
(1, 3, 15, 10, 3)
>>> round(float(said["score"][0]))
234

Preview, surrogate (`Checker`) and reference (`render_transport`) predict the same array::

    with tactilux.Preview(scene) as preview:
        T, background = preview.transport(baseline.phi[:, None], bends)
    rendered = tactilux.render_transport(scene, baseline.phi[:, None], bends, samples=64)
    rendered.T, rendered.se, rendered.background, rendered.background_se

A design is searched, and proven, in two lines::

    found = tactilux.explore("finger20")
    proof = tactilux.verify(found.design, "finger20")

Where a scene is meant, its name or its file will do, for a design its file, for a model its folder.
Nothing is written to the terminal unless ``progress=True`` asks for a bar.

Importing this module loads nothing; every name loads what it needs when it is first used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from render.steady_sums import steady_sums

if TYPE_CHECKING:
    from optimize.design import Design, baseline_design, load_design, save_design
    from optimize.dimensions import Study
    from optimize.exploration import Exploration, Stage
    from optimize.objectives import ObjectiveName, ReaderName
    from optimize.placement import SearchSpace
    from optimize.readers import ErrorComparison
    from optimize.search import SearchStep
    from optimize.verification import Optimization, OptimizationMethod, Verification
    from render import register_plugins
    from render.arrays import Array
    from render.errors import (
        CompilerError,
        DesignError,
        GraphicsError,
        ModelError,
        ReadError,
        RenderError,
        SceneError,
        TableError,
        TactiluxError,
    )
    from render.preview import Preview
    from render.progress import OnProgress
    from render.reference import TransportEstimate
    from render.scene import Scene, load_scene, save_scene
    from render.transport import TransportTable, load_table
    from surrogate.runtime import Checker

_HOMES = {
    "Scene": "render.scene",
    "load_scene": "render.scene",
    "Preview": "render.preview",
    "TransportTable": "render.transport",
    "load_table": "render.transport",
    "register_plugins": "render",
    "Checker": "surrogate.runtime",
    "Design": "optimize.design.design",
    "baseline_design": "optimize.design.design",
    "load_design": "optimize.design.design_file",
    "save_design": "optimize.design.design_file",
    "save_scene": "render.scene",
    "TactiluxError": "render.errors",
    "SceneError": "render.errors",
    "DesignError": "render.errors",
    "TableError": "render.errors",
    "ModelError": "render.errors",
    "ReadError": "render.errors",
    "GraphicsError": "render.errors",
    "CompilerError": "render.errors",
    "RenderError": "render.errors",
}
"""Where each name lives that this module hands on."""

__all__ = [
    "Checker",
    "CompilerError",
    "Design",
    "DesignError",
    "GraphicsError",
    "ModelError",
    "Preview",
    "ReadError",
    "RenderError",
    "Scene",
    "SceneError",
    "TableError",
    "TactiluxError",
    "TransportTable",
    "baseline_design",
    "build",
    "explore",
    "load_design",
    "load_model",
    "load_scene",
    "load_table",
    "optimize",
    "picture",
    "places",
    "rate",
    "reconstruct",
    "register_plugins",
    "render_transport",
    "save_design",
    "save_scene",
    "study",
    "verify",
]


def __getattr__(name: str) -> Any:
    """Return a name of another module, loaded when it is first asked for (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'tactilux' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)


@steady_sums()
def load_model(
    scene: Scene | str | Path,
    folder: str | Path | None = None,
    *,
    coarse: bool = False,
    progress: OnProgress | bool | None = None,
) -> Checker:
    """Return the trained surrogate of ``scene``, or its preview, corrected by traced light.

    The first time that takes about a minute where none was trained: light is traced to every facet.

    Arguments:
        scene: the sensor, its name or its file.
        folder: that holds ``checker.onnx`` (default: found by the scene's hash, here
            or as shipped).
        coarse: take the preview alone, in seconds, and less exact; for studies of variants.
        progress: called with how far the preview is, and with notes on the model; True is a bar.

    Raises:
        ModelError: there is none in ``folder``, or it is altered, corrupt or of another scene.
        GraphicsError: there is none, and no OpenGL library can draw the preview.
    """
    from optimize.scoring import scene_model
    from optimize.ui.console import shown_progress
    from render.arguments import as_kind, as_path
    from render.errors import ModelError
    from render.scene import as_scene

    sensor = as_scene(scene)
    given = None if folder is None else as_path(folder, "folder", ModelError)
    as_kind(coarse, bool, "coarse", "True or False", ModelError)
    with shown_progress(progress, "Making the preview") as report:
        return scene_model(sensor, given, coarse=coarse, progress=report)


@steady_sums()
def rate(
    design: Design | str | Path,
    scene: Scene | str | Path,
    *,
    model: Checker | str | Path | None = None,
    progress: OnProgress | bool | None = None,
) -> Stage:
    """Return what the surrogate says of ``design``, in milliseconds.

    Arguments:
        design: what is rated, or its file.
        scene: its sensor, or the name or the file of that.
        model: its surrogate, or the folder of that (default: `load_model`).
        progress: as of `load_model`.

    Returns:
        ``rating`` (score S of thesis eq. 4.7 in counts with a 90 % interval), ``counts``
        ``(bend, site, facet, channel)``, ``metric`` ``(bend, site)``, ``clipped``, and
        ``normal_error`` in degrees.
    """
    from optimize.exploration import rate as run

    sensor, checker = _model_of(scene, model, progress)
    return run(checker, sensor, "design", "Design", "", _design_of(design, sensor))


@steady_sums()
def reconstruct(
    design: Design | str | Path,
    scene: Scene | str | Path,
    *,
    model: Checker | str | Path | None = None,
    read_noise: float | None = None,
    full_well: float | None = None,
    seed: int = 0,
    progress: OnProgress | bool | None = None,
) -> dict[str, ErrorComparison]:
    """Return by how many degrees normals are recovered from the colors, against the baseline.

    Arguments:
        design: whose colors are read, or its file.
        scene: its sensor, or the name or the file of that.
        model: its surrogate, or the folder of that (default: `load_model`).
        read_noise: of the camera, one standard deviation in counts (default: the scene's).
        full_well: photoelectrons at 255 counts, for the shot noise (default: the scene's).
        seed: of normals and noise, which both designs share.
        progress: as of `load_model`.

    Returns:
        ``lookup_mean``, ``lookup_95%``, ``regressor_mean`` and ``regressor_95%``: errors of
        ``baseline`` and ``design`` in degrees, their ``difference`` and its 95 % ``interval``.
    """
    from optimize.design import dimmed_baseline
    from optimize.readers import SEEDS, CameraModel, compare_readings, reading
    from optimize.scoring import predicted_colors
    from render.arguments import as_number, as_whole
    from render.errors import DesignError

    first = as_whole(seed, "seed", DesignError, least=0)
    given = {"read_noise": (read_noise, 0.0), "full_well": (full_well, 1.0)}
    stated = {
        name: as_number(value, name, DesignError, least=least)
        for name, (value, least) in given.items()
        if value is not None
    }
    sensor, checker = _model_of(scene, model, progress)
    camera = CameraModel.of(sensor).stating(**stated)
    designs = [dimmed_baseline(sensor), _design_of(design, sensor)]
    seeds = range(first, first + SEEDS)
    colors = [predicted_colors(checker, each) for each in designs]
    return compare_readings(*(reading(sensor, known, camera, seeds) for known in colors))


@steady_sums()
def picture(
    design: Design | str | Path,
    scene: Scene | str | Path,
    *,
    bend: float = 0.0,
    size: tuple[int, int] | None = None,
    pressed: bool = True,
    samples: int | None = None,
    seed: int = 1,
    progress: OnProgress | bool | None = None,
) -> Array:
    """Return what the camera records of a design, in counts that saturate at 255.

    Arguments:
        design: that lights the pad, or its file.
        scene: its sensor, or the name or the file of that.
        bend: rad in [0, pi], or the number of one of the scene's states.
        size: columns and rows (default: the camera's).
        pressed: by the pyramids, or untouched.
        samples: light paths per pixel of the reference; None draws the preview, in a second.
        seed: of the light paths.
        progress: called every few seconds of a render; True is a bar.

    Returns:
        ``(row, column, channel)``, float64, as the camera sees it: from within, the tip up.
        Renders are smoothed over pixels nearby that see the same face.
    """
    from optimize.ui.console import shown_progress
    from render.arguments import as_number, as_whole
    from render.choose_exposure import scene_scale
    from render.errors import RenderError
    from render.metric import clip_counts
    from render.preview import Preview
    from render.reference import render_image, smoothed
    from render.scene import as_scene

    sensor = as_scene(scene)
    lit, (columns, rows) = _design_of(design, sensor), _size(size, sensor)
    angle, chance = (
        as_number(bend, "bend", RenderError, least=0.0),
        as_whole(seed, "seed", RenderError, least=0),
    )
    count = None if samples is None else as_whole(samples, "samples", RenderError, least=1)
    with shown_progress(progress, "Rendering") as report:
        if count is None:
            with Preview(sensor) as preview:
                drawn = preview.picture(lit.phi, lit.power, angle, columns, rows, pressed)
            light = drawn.astype(float)
        else:
            found = render_image(
                sensor, lit.phi, lit.power, angle, width=columns, height=rows, samples=count,
                seed=chance, indented=pressed, progress=report,
            )  # fmt: skip
            light = smoothed(found).radiance
    # Both draw the skin from outside; the camera looks from within.
    counts: Array = clip_counts(scene_scale(sensor).exposure * light[:, ::-1])
    return counts


@steady_sums()
def render_transport(
    scene: Scene | str | Path,
    phi: Array,
    bends: Array,
    *,
    samples: int,
    seeds: Sequence[int] = (1,),
    replicates: int = 8,
    checkpoint: str | Path | None = None,
    progress: OnProgress | bool | None = None,
) -> TransportEstimate:
    """Render the transport of all fibers at all bends: the reference.

    Arguments:
        scene: the sensor, its name or its file.
        phi: direction nodes in rad, ``(node,)`` for all fibers or ``(fiber, node)``.
        bends: ``(bend,)`` rad, within [0, pi], or numbers of the scene's states.
        samples: light paths per (fiber, facet) pair and seed, on average.
        seeds: independent runs; the same seeds give common random numbers between designs.
        replicates: independent groups of paths per seed, for the error bars.
        checkpoint: a folder; interrupted, the same call goes on from there and ends bit-equal.
        progress: called every few seconds; True is a bar.

    Returns:
        ``T`` and its standard error ``se``, ``(fiber, node, bend, site, facet[, channel])`` in
        1/(mm^2 sr) per unit power of one fiber; ``background`` and ``background_se`` of the
        untouched pad; ``replicates``, whose mean is ``T``.

    Raises:
        RenderError: an argument out of range, or no light found.
        SceneError: a site that counts is not seen at one of ``bends``.
    """
    from optimize.ui.console import shown_progress
    from render.reference import render_transport as run

    with shown_progress(progress, "Rendering") as report:
        return run(
            scene, phi, bends, samples=samples, seeds=seeds, replicates=replicates,
            checkpoint=checkpoint, progress=report,
        )  # fmt: skip


@steady_sums()
def explore(
    scene: Scene | str | Path,
    *,
    model: Checker | str | Path | None = None,
    objective: ObjectiveName = "sensor",
    seed: int = 0,
    progress: Callable[[SearchStep], None] | bool | None = None,
) -> Exploration:
    """Return a better design for ``scene``, searched and rated on the surrogate in seconds.

    Arguments:
        scene: the sensor, its name or its file; the search keeps to its constraints.
        model: its surrogate, or the folder of that (default: `load_model`).
        objective: what is improved: ``sensor``, the degrees by which one reader for the whole
            sensor misses normals; ``place``, those of a reader that knows every place; or
            ``score``, S of thesis eq. 4.7.
        seed: of the search; the same seed gives the same design.
        progress: called after every step of the search; True says the steps on stderr.

    Returns:
        ``design``, its ``rating`` (score S of thesis eq. 4.7 in counts with a 90 % interval), and
        ``stages`` from the baseline on. What does not read better than the baseline is not
        handed over: then it is the baseline.
    """
    from optimize.exploration import explore as run
    from optimize.objectives import OBJECTIVES
    from optimize.ui.console import shown_progress
    from render.arguments import as_one_of, as_whole
    from render.errors import DesignError
    from render.progress import Progress

    chosen = as_whole(seed, "seed", DesignError, least=0)
    as_one_of(objective, OBJECTIVES, "objective", DesignError)
    with shown_progress(progress, "Exploring") as report:  # type: ignore[arg-type]
        sensor, checker = _model_of(scene, model, report if progress is True else None)
        told: Any = report
        if progress is True and report is not None:

            def told(step: SearchStep) -> None:
                report(Progress.of_note(f"{step.stage}: score {step.score:.1f}"))

        return run(
            sensor,
            checker,
            objective=objective,
            seed=chosen,
            progress=told,
            report=report if progress is True else None,
        )


@steady_sums()
def places(
    scene: Scene | str | Path,
    lamps: int | None = None,
    *,
    parts: Sequence[str] | None = None,
    shots: int | None = None,
) -> Scene:
    """Return ``scene`` with a lamp that is off on every place where one may sit.

    A search of it chooses where lamps sit, and `build` makes the sensor that its design is::

        free = tactilux.places("digit", lamps=3)
        found = tactilux.explore(free)
        mine = tactilux.build(found.design, free, "mine")

    Arguments:
        scene: the sensor, its name or its file; places are those of its ``[search]``, or else
            along every edge that holds lamps of its kind.
        lamps: at most so many are lit (default: as its ``[search]`` says, or the baseline lights).
        parts: names of LEDs, one of which every lamp is (default: as its ``[search]`` says).
        shots: pictures that are taken one after the other (default: as its ``[camera]`` says).
    """
    from render.scene import as_scene

    return _search_space(True, lamps, parts, shots).on(as_scene(scene))


@steady_sums()
def build(design: Design | str | Path, scene: Scene | str | Path, name: str) -> Scene:
    """Return the sensor that a design is: the lamps that it lights, as the baseline.

    Arguments:
        design: of ``scene``, or its file.
        scene: with the places from which the design chose, its name or its file.
        name: of the sensor, as its file will say; `save_scene` writes that.
    """
    from optimize.placement import built_scene
    from render.arguments import as_kind
    from render.errors import SceneError
    from render.scene import as_scene

    sensor = as_scene(scene)
    as_kind(name, str, "name", "the name of a sensor, a text", SceneError)
    return built_scene(sensor, _design_of(design, sensor), name)


@steady_sums()
def study(
    scene: Scene | str | Path,
    vary: Mapping[str, str | Sequence[float]],
    *,
    objective: ReaderName = "sensor",
    coarse: bool = False,
    lamps_follow: bool = False,
    place: bool = False,
    lamps: int | None = None,
    parts: Sequence[str] | None = None,
    shots: int | None = None,
    seed: int = 0,
    checkpoint: str | Path | None = None,
    progress: OnProgress | bool | None = None,
) -> Study:
    """Return what numbers of a scene file are worth, each value with the best lights found for it.

    One number is a grid, as are few combinations of several; others are searched by CMA-ES.
    ``search.lamps`` and ``search.runs`` are numbers as well: ``pareto`` of the study has the values
    that are worth what they cost::

        found = tactilux.study("digit", {"pad.thickness": [4, 5], "coating.albedo": "0.3:0.6:0.1"})
        found.best.scene, found.best.design

    Arguments:
        scene: the sensor as it is, its name or its file.
        vary: values by keys of the scene file, such as ``rows.0.height``, ``rows.left.height`` or,
            for all rows, ``rows.height``; a list, or a text ``low:high:step``, in the file's unit.
        objective: whose degrees decide, the ``sensor`` or the ``place`` reader's.
        coarse: ask the preview alone, in seconds a sensor; else traced light answers too.
        lamps_follow: lamps keep their height as a part of a ``pad.thickness`` that is varied.
        place: lamps may sit elsewhere on every sensor: on the places of its file, or any edge.
        lamps: at most so many are lit (default: as the scene says).
        parts: names of LEDs, one of which every lamp is (default: as the scene says).
        shots: pictures that are taken one after the other (default: as the scene says).
        seed: of all searches; the same seed gives the same study.
        checkpoint: a folder; interrupted, the same call goes on from there.
        progress: told of every sensor; True is a bar.

    Returns:
        ``rows`` and ``finalists`` with ``values`` and ``changes`` from the sensor as it is, the
        ``sentence`` that sums up, and ``best``: the best sensor and its lights, rated. Notebooks
        show a table; ``plot()`` gives a figure. A sensor that is not certain to be better is not
        handed over: ``best`` is then the one as it is.
    """
    from optimize.dimensions import Variants, dimensions_of, run_study
    from optimize.objectives import READERS
    from optimize.ui.console import shown_progress
    from render.arguments import as_folder, as_kind, as_one_of, as_whole
    from render.errors import DesignError, SceneError
    from render.scene import as_scene

    sensor = as_scene(scene)
    as_one_of(objective, READERS, "objective", DesignError)
    as_kind(coarse, bool, "coarse", "True or False", SceneError)
    as_kind(lamps_follow, bool, "lamps_follow", "True or False", SceneError)
    chosen = as_whole(seed, "seed", SceneError, least=0)
    folder = as_folder(checkpoint, "checkpoint", SceneError)
    space = _search_space(place, lamps, parts, shots)
    variants = Variants(sensor, dimensions_of(sensor, vary), lamps_follow=lamps_follow, space=space)
    with shown_progress(progress, "") as report:
        return run_study(
            variants, reader=objective, coarse=coarse, seed=chosen, folder=folder, progress=report
        )


@steady_sums()
def verify(
    design: Design | str | Path,
    scene: Scene | str | Path,
    *,
    model: Checker | str | Path | None = None,
    samples: int = 200,
    seeds: Sequence[int] = (1, 2, 3, 4),
    checkpoint: str | Path | None = None,
    progress: OnProgress | bool | None = None,
) -> Verification:
    """Return what renders say about ``design`` against the baseline.

    Arguments:
        design: what is verified, or its file.
        scene: its sensor, or the name or the file of that.
        model: the surrogate whose prediction is checked, or its folder; exposure and lambda are
            its own.
        samples: light paths per (fiber, facet) pair and seed.
        seeds: common to both designs.
        checkpoint: a folder; interrupted, the same call goes on from there and ends bit-equal.
        progress: called every few seconds with what is rendered; True is a bar.

    Returns:
        ``baseline`` and ``design`` (scores with standard errors, counts), their ``difference``
        with an interval, and ``conclusion``, one sentence.
    """
    from optimize.exploration import rate as rated
    from optimize.ui.console import shown_progress
    from optimize.verification import verify as run
    from render.arguments import as_folder, as_seeds, as_whole
    from render.errors import RenderError

    count, chosen = as_whole(samples, "samples", RenderError, least=1), as_seeds(seeds, RenderError)
    folder = as_folder(checkpoint, "checkpoint", RenderError)
    with shown_progress(progress, "Verifying") as report:
        sensor, checker = _model_of(scene, model, report)
        stage = rated(checker, sensor, "design", "Design", "", _design_of(design, sensor))
        return run(stage, checker, samples=count, seeds=chosen, checkpoint=folder, progress=report)


@steady_sums()
def optimize(
    scene: Scene | str | Path,
    *,
    model: Checker | str | Path | None = None,
    method: OptimizationMethod = "loop",
    objective: ObjectiveName = "sensor",
    samples: int = 96,
    seed: int = 0,
    checkpoint: str | Path | None = None,
    progress: OnProgress | bool | None = None,
) -> Optimization:
    """Return a design that renders chose: the surrogate proposes, the reference decides.

    Arguments:
        scene: the sensor, its name or its file.
        model: its surrogate, or the folder of that (default: `load_model`).
        method: the verification ``loop``, the ``thesis`` procedure, or ``both`` side by side.
        objective: what decides: degrees of the ``sensor`` or the ``place`` reader, or ``score``.
        samples: light paths per (fiber, facet) pair of every candidate's render.
        seed: of searches and renders.
        checkpoint: a folder; interrupted, the same call goes on from there.
        progress: called every few seconds with what is rendered; True is a bar.
    """
    from optimize.objectives import OBJECTIVES
    from optimize.ui.console import shown_progress
    from optimize.verification import OptimizationMethod, OptimizeConfig, reference_renders
    from optimize.verification import optimize as run
    from render.arguments import as_folder, as_one_of, as_whole
    from render.errors import RenderError

    as_one_of(method, get_args(OptimizationMethod), "method", RenderError)
    as_one_of(objective, OBJECTIVES, "objective", RenderError)
    count = as_whole(samples, "samples", RenderError, least=1)
    chosen = as_whole(seed, "seed", RenderError, least=0)
    folder = as_folder(checkpoint, "checkpoint", RenderError)
    config = OptimizeConfig(method, objective, count, seed=chosen)
    with shown_progress(progress, "Optimizing") as report:
        sensor, checker = _model_of(scene, model, report)
        return run(sensor, checker, reference_renders(sensor, folder, report), config)


def _model_of(
    scene: Scene | str | Path, model: Checker | str | Path | None, progress: Any
) -> tuple[Scene, Checker]:
    """Return a scene with its model, however both are given; True and a function tell of it."""
    from optimize.scoring import as_model
    from optimize.ui.console import shown_progress
    from render.scene import as_scene

    sensor = as_scene(scene)
    with shown_progress(progress, "Making the preview") as report:
        return sensor, as_model(model, sensor, report)


def _search_space(place: object, lamps: object, parts: object, shots: object) -> SearchSpace:
    """Return what may be chosen on a sensor."""
    from optimize.placement import SearchSpace
    from render.arguments import as_kind, as_whole
    from render.errors import SceneError

    names, allowed = None, "a list of names"
    if parts is not None:
        listed = as_kind(parts, list | tuple, "parts", allowed, SceneError)
        names = tuple(as_kind(name, str, "parts", allowed, SceneError) for name in listed)
    return SearchSpace(
        bool(as_kind(place, bool, "place", "True or False", SceneError)),
        None if lamps is None else as_whole(lamps, "lamps", SceneError, least=1),
        names,
        None if shots is None else as_whole(shots, "shots", SceneError, least=1),
    )


def _design_of(design: Design | str | Path, scene: Scene) -> Design:
    from optimize.design import as_design

    return as_design(design, scene)


def _size(size: tuple[int, int] | None, scene: Scene) -> tuple[int, int]:
    """Return columns and rows of a picture."""
    from render.arguments import as_whole, refuse
    from render.errors import RenderError
    from render.scene import MOST_PIXELS

    if size is None:
        return scene.camera.columns, scene.camera.rows
    if not isinstance(size, tuple | list) or len(size) != 2:
        refuse(size, "size", "columns and rows, such as (240, 400)", RenderError)
    columns, rows = (as_whole(side, "size", RenderError, least=1) for side in size)
    if max(columns, rows) > MOST_PIXELS:
        refuse(size, "size", f"at most {MOST_PIXELS} columns and rows", RenderError)
    return columns, rows
