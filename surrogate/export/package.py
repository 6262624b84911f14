"""Writing a model folder: network, card, checksums and golden pair appear together."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from render.errors import ModelError
from render.files import can_create, write_json, write_npz, write_text
from render.folders import foreign_names, fresh_folder, put_back, remove_folder, replace_folder
from render.geometry import counted_sites
from render.scene import Scene
from surrogate.export.onnx import export_onnx
from surrogate.model.checker_module import CheckerModule
from surrogate.runtime import ModelMetadata
from surrogate.runtime.model_file import (
    CARD_FILE,
    GOLDEN_FILE,
    LARGEST,
    MODEL_FILE,
    OUTPUTS,
    SECONDS_FILE,
    SUM_FILE,
    SUMMED,
    sums_of,
)

FILES = {MODEL_FILE, CARD_FILE, SUM_FILE, GOLDEN_FILE, SECONDS_FILE}
OTHER_NUMBERS = 56
"""Constants of a lamp and a site besides its preview: inputs of the residual, basis of facets."""
GRAPH = 26_400
"""Bytes of a model without its constants."""


def check_size(
    scene: Scene, directions: int, bends: int, *, terms: int = 0, weights: int = 0
) -> None:
    """Refuse a sensor whose model would be too large, before anything is rendered for it.

    Arguments:
        scene: the sensor.
        directions: nodes of its preview in phi.
        bends: nodes in bend, or named states.
        terms: how many slopes every number of the preview has, of two bytes each.
        weights: numbers of the residual.

    Raises:
        ModelError: says how many sites there may be.
    """
    lamps, faces = scene.lamp_count * len(scene.albedos), scene.indenter.faces
    numbers = (4 + 2 * terms) * directions * bends * (faces + 1) + 4 * OTHER_NUMBERS
    fixed, sites = GRAPH + 4 * weights, len(counted_sites(scene))
    size = fixed + lamps * numbers * sites
    if size >= LARGEST:
        of = "bend" if scene.states is None else "state"
        most = max((LARGEST - 1 - fixed) // (lamps * numbers), 0)
        raise ModelError(
            f"the model of {sites} sites, {faces} facets and {lamps} lamps at {directions} "
            f"directions and {bends} {of}{'s' * (bends != 1)} of its preview would have some "
            f"{size} bytes, allowed: below {LARGEST}; give the scene fewer sites (at most {most}) "
            f"or facets{'' if scene.states is None else ', or fewer states'}",
            field="sites",
        )


def write_package(
    folder: Path,
    checker: CheckerModule,
    metadata: ModelMetadata,
    card: str,
    golden_inputs: Mapping[str, np.ndarray],
    seconds: Mapping[str, float],
) -> None:
    """Write the model to ``folder``, replacing an older one; ``seconds`` by what took them.

    Everything is written into a folder beside it, replayed through onnxruntime, and renamed: a
    reader, or a run that was killed, never meets half a model.

    Raises:
        ModelError: ``folder`` holds other files, or the model exceeds its size.
    """

    def settle(old: Path) -> None:
        remove_folder(old, SUM_FILE)

    put_back(folder, SUM_FILE, settle)
    check_replaceable(folder)
    with fresh_folder(folder) as fresh:
        model = fresh / MODEL_FILE
        export_onnx(checker, metadata.fibers, model, metadata.to_props())
        if model.stat().st_size >= LARGEST:
            raise ModelError(
                f"{MODEL_FILE} would have {model.stat().st_size} bytes, allowed: below {LARGEST}; "
                "train with fewer preview nodes",
                field=MODEL_FILE,
            )
        write_npz(fresh / GOLDEN_FILE, {**golden_inputs, **_replay(model, golden_inputs)})
        write_text(fresh / CARD_FILE, card)
        write_json(fresh / SECONDS_FILE, seconds)
        write_text(fresh / SUM_FILE, sums_of({n: (fresh / n).read_bytes() for n in SUMMED}))
        replace_folder(fresh, folder, settle)


def check_replaceable(folder: Path) -> None:
    """Refuse a folder that holds anything but a model.

    Raises:
        ModelError: names what else is in there, or nothing can be written there.
    """
    if not folder.exists():
        if not can_create(folder):
            raise ModelError(
                f"{folder} cannot be created, its place is not a writable directory: name another "
                "folder",
                field="out",
            )
        return
    if not folder.is_dir():
        raise ModelError(f"{folder} is not a folder: name another place", field="out")
    others = foreign_names(folder) - FILES
    if others:
        raise ModelError(
            f"{folder} holds {sorted(others)[0]}, which is no part of a model: name another folder",
            field="out",
        )


def _replay(model: Path, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    import onnxruntime

    session = onnxruntime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    return dict(zip(OUTPUTS, session.run(list(OUTPUTS), dict(inputs)), strict=True))
