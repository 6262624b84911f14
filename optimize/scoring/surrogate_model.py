"""The model of a scene: finding it, or making do without one, and what it says of designs.

Where none was trained, the preview that traced light corrects answers.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from optimize.design import RUN_MODEL, Array, Design, RatedDesign, noise_words
from optimize.scoring.confidence import normal_factor
from optimize.ui.console import ProgressBar
from render.arguments import as_path
from render.chebyshev import chebyshev_nodes
from render.errors import ModelError
from render.levels import PREVIEW
from render.progress import OnProgress, Progress
from render.refused_values import did_you_mean
from render.scene import Scene
from render.transport import TransportTable
from surrogate.runtime import MODEL_FILE, Checker

# Direction nodes of the table that is searched: its interpolation then moves a score by less than
# 0.1 counts (measured; with 17 nodes by 0.9).
PHI_NODES = 33


def trained_model(
    scene: Scene,
    given: Path | None = None,
    *,
    threads: int | None = None,
    design: Path | None = None,
) -> Checker | None:
    """Return the trained model of a scene, None where there is none.

    That in the folder given, or the one of the right scene hash, whatever its name: that of the run
    in which the file ``design`` lies, or among those in ``models`` of the current directory and
    those that come with tactilux; folders named like the scene are tried first. A model with a free
    material serves its whole family of hashes. Only the one that is taken is opened.

    The hash covers all that a facet's color depends on, the camera's columns and rows too: with
    other pixels on a facet its light is another mean (finger20 at 640 x 480: by 4 % at the 95th
    percentile, as much as the model's own error; the untouched pad's by less than 0.01 %).

    Raises:
        ModelError: there is none in ``given``, or it is damaged or of another scene; or one named
            like the scene is damaged.
    """
    if given is not None:
        if (given / MODEL_FILE).is_file():
            return Checker.for_scene(given, scene, threads=threads)
        beside = [str(file.parent) for file in given.parent.glob(f"*/{MODEL_FILE}")]
        raise ModelError(
            f"there is no {MODEL_FILE} in {given}: name the folder of a model or make one with "
            f"tactilux train{did_you_mean(given, beside)}",
            field="model",
            option="--model",
        )
    found: list[Path] = []
    for place in (Path("models"), Path(__file__).resolve().parents[2] / "models"):
        found += sorted(file.parent for file in place.glob(f"*/{MODEL_FILE}"))
    found.sort(key=lambda folder: folder.name != scene.name)
    runs = () if design is None else (design.parent / RUN_MODEL, design.parent.parent / RUN_MODEL)
    found[:0] = [folder for folder in runs if (folder / MODEL_FILE).is_file()]
    for folder in found:
        try:
            return Checker.for_scene(folder, scene, threads=threads)
        except ModelError as error:
            if folder.name == scene.name and error.field != "scene_hash":
                raise
    return None


def open_model(
    scene: Scene,
    given: Path | None = None,
    *,
    threads: int | None = None,
    coarse: bool = False,
    design: Path | None = None,
) -> Checker:
    """Return the model of ``scene`` as `scene_model` does, which says on stderr what it does.

    Raises:
        ModelError: as `scene_model` does.
        GraphicsError: as `scene_model` does.
    """
    with ProgressBar("Making the preview") as bar:
        return scene_model(
            scene, given, threads=threads, coarse=coarse, design=design, progress=bar
        )


def scene_model(
    scene: Scene,
    given: Path | None = None,
    *,
    threads: int | None = None,
    coarse: bool = False,
    design: Path | None = None,
    progress: OnProgress | None = None,
) -> Checker:
    """Return the model of ``scene``: a trained one, or what there is without one, see the module.

    Converged light takes one to three minutes, unless it is kept, as `is_prompt` says.

    Arguments:
        scene: the sensor.
        given: folder of the model (default: see `trained_model`).
        threads: of the runtime (default: its own choice).
        coarse: take the preview as the shader draws it, even where there is a better answer.
        design: file of a design, whose run may hold a model.
        progress: told how far the preview is, and in notes which level answers, and where the
            scene leaves the range that a model was trained for.

    Raises:
        ModelError: there is none in ``given``, or it is damaged or of another scene; or a model
            is given and the coarse preview asked for.
        GraphicsError: there is none, and no OpenGL library can draw the preview.
    """
    tell = progress or (lambda _: None)
    if coarse and given is not None:
        raise ModelError(
            f"coarse asks for the preview, but {given} for a model, allowed: one of them",
            field="model",
            option="--coarse or --model",
        )
    checker = None if coarse else trained_model(scene, given, threads=threads, design=design)
    if checker is None:
        from surrogate.preview_model import preview_checker

        checker = preview_checker(scene, progress, coarse=coarse)
        if not coarse:
            tell(
                Progress.of_note(
                    f"There is no model for scene {scene.name}, hash {scene.hash}: this is the "
                    f"{checker.level_name}{noise_words(checker.photon_noise)}; tactilux train "
                    "makes a model"
                )
            )
        return checker
    unlit = np.zeros((1, scene.lamp_count, len(scene.palette.channels)))
    dark = np.full(unlit.shape[:2], np.pi / 2), unlit, np.array(scene.state_axis)
    excess = float(checker.run(*dark)["domain_excess"][0])
    if excess > 0.0:
        free = checker.metadata.material
        names = zip(free.get("names", []), checker.material, free.get("low", []),
                    free.get("high", []), strict=True)  # fmt: skip
        told = [f"{name} {value:g} (trained {low:g} to {high:g})"
                for name, value, low, high in names if not low <= value <= high]  # fmt: skip
        outside = f": {', '.join(told)}" if told else ""
        tell(
            Progress.of_note(
                f"Warning: scene {scene.name} lies outside the range that its model was trained "
                f"for{outside} (domain excess {excess:.2g}): what the surrogate says of it is an "
                "extrapolation; train a model for it, or verify by renders"
            )
        )
    return checker


def as_model(
    value: Checker | str | Path | None, scene: Scene, progress: OnProgress | None = None
) -> Checker:
    """Return the model that is given, that of a folder, or what `scene_model` finds for None.

    Raises:
        ModelError: it is none, or of another scene.
    """
    if not isinstance(value, Checker):
        folder = None if value is None else as_path(value, "model", ModelError)
        return scene_model(scene, folder, progress=progress)
    if value.scene_hash != scene.hash:
        raise ModelError(
            f"model = {value!r}, which is of another scene, allowed: hash {scene.hash} of "
            f"{scene.name}; load_model gives it",
            field="model",
        )
    return value


def model_of_design(
    candidate: RatedDesign, given: Path | None = None, design: Path | None = None
) -> Checker:
    """Return what rated a design, or what knows its scene better and is there at once.

    ``design`` is its file.
    A design that was rated on the preview waits for no traced light: see `open_model`.
    """
    scene, drawn = candidate.scene, candidate.rating.level == PREVIEW
    drawn = drawn and not is_prompt(scene, given, design)
    return open_model(scene, given, coarse=drawn, design=design)


def first_model(scene: Scene) -> Checker:
    """Return what answers while `open_model` takes long: the surrogate of few light paths.

    Raises:
        GraphicsError: no OpenGL library can draw the preview.
    """
    from surrogate.preview_model import few_paths_checker

    with ProgressBar("Making a first preview") as bar:
        return few_paths_checker(scene, bar)


def search_table(checker: Checker) -> TransportTable:
    """Return the surrogate's transport at the direction nodes that searches interpolate between.

    Where beams are narrow, those are as many as its own.
    """
    nodes = max(PHI_NODES, checker.metadata.preview["phi_nodes"])
    return checker.transport_table(chebyshev_nodes(nodes, 0.0, np.pi))


def is_prompt(scene: Scene, given: Path | None = None, design: Path | None = None) -> bool:
    """Return whether `open_model` answers in seconds: it has a model, or all of its preview."""
    if trained_model(scene, given, design=design) is not None:
        return True
    from render.preview.converged import is_kept

    return is_kept(scene)


def predict_design(checker: Checker, design: Design, bends: Array) -> dict[str, Array]:
    """Return all outputs of checker.onnx for ``design`` at ``bends`` rad, without an axis batch."""
    outputs = checker.run(design.phi[None], design.power[None], bends)
    return {name: np.asarray(value[0], dtype=np.float64) for name, value in outputs.items()}


def predicted_colors(checker: Checker, design: Design) -> Array:
    """Return colors of facets and untouched pad at the scene's states, as the surrogate has them.

    Counts ``(B, S, facet + 1, C)`` at the scene's exposure, the pad last, not clipped: light is
    linear, so what would saturate is asked for at less power.
    """
    output, part = _unclipped(checker, design)
    return np.concatenate([output["counts"], output["background"][:, :, None]], axis=2) / part


def predicted_spread(checker: Checker, design: Design) -> Array:
    """Return one standard deviation of what `predicted_colors` are off by, of their shape.

    It is what held-out renders calibrated, without their noise. The pad is off by as much as the
    facets of its site, relatively, and photon noise of traced light comes on top.
    """
    output, part = _unclipped(checker, design)
    counts, spread = output["counts"], output["counts_spread"]
    spread = spread * (checker.counts_factor / normal_factor(checker.coverage))
    facets = counts.sum(axis=2)
    relative = np.divide(spread.sum(axis=2), facets, out=np.zeros_like(facets), where=facets > 0.0)
    pad = output["background"][:, :, None]
    both = np.concatenate([spread, relative[:, :, None] * pad], axis=2)
    noise = (checker.photon_noise or 0.0) * np.concatenate([counts, pad], axis=2)
    return np.asarray(np.hypot(both, noise) / part)


def _unclipped(checker: Checker, design: Design) -> tuple[dict[str, Array], float]:
    """Return outputs at the scene's states at so little power that nothing clips, and its part."""
    states, limit = np.array(checker.metadata.scene_bends), checker.metadata.metric.count_max
    part = 1.0
    while True:
        output = predict_design(checker, replace(design, drive=design.drive * part), states)
        if max(output["counts"].max(), output["background"].max()) < limit:
            return output, part
        part /= 4.0
