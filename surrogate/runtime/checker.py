"""Running ``checker.onnx``: numpy and onnxruntime alone, no torch, no OpenGL, no renderer."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from render.arguments import as_kind, as_numbers, as_path, as_whole
from render.arrays import Array
from render.errors import ModelError
from render.levels import Effort, Level, level_name
from render.transport import TransportTable
from surrogate.runtime.metadata import ModelMetadata
from surrogate.runtime.model_file import (
    MATERIAL,
    OUTPUTS,
    described,
    failed,
    failures,
    open_session,
    replay,
)

if TYPE_CHECKING:  # a scene comes with pydantic, which a program with a model may lack
    from render.scene import Scene

# Designs per call of the runtime: enough to fill its threads, few enough to stay in the cache.
_BATCH = 64


class Checker:
    """A surrogate model, ready to run.

    Arguments:
        session: the onnxruntime session.
        metadata: what the model says about itself.
        material: the free quantities ``(quantity,)`` of the scene that it is asked for, in the
            order and units of ``metadata.material``; empty where nothing is free.
        scene_hash: of that scene.
        file: that it was loaded from; None for the preview, which was drawn.
    """

    def __init__(
        self,
        session: Any,
        metadata: ModelMetadata,
        material: Array | None = None,
        scene_hash: str | None = None,
        file: Path | None = None,
    ) -> None:
        """Take an open session; use :meth:`load` or :meth:`for_scene` for files."""
        as_kind(metadata, ModelMetadata, "metadata", "what a model file says of itself", ModelError)
        self._session = session
        self.metadata = metadata
        nominal = np.array(metadata.material.get("nominal", []), dtype=np.float64)
        self.material = nominal if material is None else material
        self.scene_hash = scene_hash or metadata.scene_hash
        self.file = file

    @classmethod
    def load(
        cls, path: str | Path, scene_hash: str | None = None, *, threads: int | None = None
    ) -> Checker:
        """Return the model in a folder, or in an ``.onnx`` file.

        A folder must hold ``checker.sha256``, and its checksums are verified; a single file is
        verified where that file lies beside it.

        Arguments:
            path: the folder or the file.
            scene_hash: hash of the scene that the model must be of.
            threads: threads of the runtime (default: its own choice).

        Raises:
            ModelError: missing, altered, corrupt, foreign, or for another scene.
        """
        if scene_hash is not None:
            as_kind(scene_hash, str, "scene_hash", "the hash of a scene, a text", ModelError)
        content, metadata, file = described(as_path(path, "path", ModelError))
        if scene_hash is not None and metadata.scene_hash != scene_hash:
            raise _foreign(file, metadata, scene_hash)
        return cls(_session(content, metadata, file, threads), metadata, file=file)

    @classmethod
    def for_scene(
        cls, path: str | Path, scene: Scene | str | Path, *, threads: int | None = None
    ) -> Checker:
        """Return the model in ``path``, as :meth:`load`, for ``scene``.

        A model with a free material serves every scene that differs in the free quantities alone;
        outside their trained range its ``domain_excess`` is positive. They all have one scale, the
        exposure and lambda of the scene that it was trained for, so that materials compare.

        Raises:
            ModelError: as :meth:`load`.
        """
        from render.scene import as_scene

        scene = as_scene(scene)
        content, metadata, file = described(as_path(path, "path", ModelError))
        material, free = None, metadata.material
        if metadata.scene_hash != scene.hash:
            layer, names = scene.diffuser, free.get("names", ())
            if layer is None or not free or family_hash(scene, tuple(names)) != free["family"]:
                raise _foreign(file, metadata, scene.hash)
            material = np.array([layer.free_values[name] for name in names])
        session = _session(content, metadata, file, threads)
        return cls(session, metadata, material, scene.hash, file)

    def __repr__(self) -> str:
        """Return in one line what answers, and for which scene."""
        where = "" if self.file is None else f", from {self.file}"
        about = f"{self.metadata.scene} ({self.scene_hash})"
        scores = f"scores ± {self.score_half_width:.3g}"
        return f"<Checker of {about}: {self.level_name}, {scores}{where}>"

    def _repr_html_(self) -> str:
        """Return the line and the errors on designs that it was not trained on."""
        from render.notebook import tabled

        held = [
            (str(row["name"]), f"{float(row['kendall_tau']):.2f}") for row in self.metadata.held_out
        ]
        return tabled(repr(self), ("prediction", "Kendall's tau on held-out designs"), held)

    @property
    def level(self) -> Level:
        """What answers: the preview as drawn, or corrected by traced light or by renders."""
        return self.metadata.level

    @property
    def effort(self) -> Effort | None:
        """What corrects the preview, and how far."""
        return self.metadata.effort

    @property
    def level_name(self) -> str:
        """Level and effort as people read them."""
        return level_name(self.level, self.effort)

    @property
    def photon_noise(self) -> float | None:
        """Photon noise of facet colors, relative, one standard deviation.

        Traced light has it; renders that a model was trained on stand for themselves.
        """
        return None if self.metadata.rendered else self.metadata.preview.get("photon_noise")

    @property
    def exposure(self) -> float:
        """Counts per 1/(mm^2 sr)."""
        return self.metadata.exposure

    @property
    def lam(self) -> float:
        """Weight of M_phi in eq. (4.6)."""
        return self.metadata.lam

    @property
    def coverage(self) -> float:
        """How often the intervals below hold the reference, 0.9."""
        return float(self.metadata.conformal["coverage"])

    @property
    def counts_factor(self) -> float:
        """Half-width of the interval of a channel of a facet, in units of ``counts_spread``."""
        return float(self.metadata.conformal["counts"])

    @property
    def score_half_width(self) -> float:
        """Half-width of the interval of a score, in counts."""
        return float(self.metadata.conformal["score"])

    def run(self, phi: Array, power: Array, bends: Array) -> dict[str, np.ndarray]:
        """Return the model's outputs for ``N`` designs, float32.

        Arguments:
            phi: ``(N, fiber)`` rad in [0, pi].
            power: ``(N, fiber, channel)`` in [0, 1], what fibers give to the channels.
            bends: ``(bend,)`` rad, the same for all designs, in [0, pi]; beyond the trained
                bends ``domain_excess`` is positive. Where ``metadata.states`` names some, their
                numbers instead.

        Returns:
            ``counts``, ``counts_spread`` ``(N, bend, site, facet, channel)``, ``background``
            ``(N, bend, site, channel)``, ``metric`` ``(N, bend, site)``, ``score`` ``(N,)`` over
            the bends given, ``domain_excess`` ``(N,)``.

        Raises:
            ModelError: wrong shape, range or unit.
        """
        fibers, channels = self.metadata.fibers, len(self.metadata.channels)
        given = {"phi": phi, "power": power, "bends": bends}
        phi, power, bends = (as_numbers(x, name, ModelError) for name, x in given.items())
        if phi.ndim != 2 or phi.shape[1] != fibers or len(phi) == 0:
            raise _shape_error("phi", phi, f"(designs, {fibers})")
        if power.shape != (len(phi), fibers, channels):
            raise _shape_error("power", power, f"({len(phi)}, {fibers}, {channels})")
        if bends.ndim != 1 or len(bends) == 0:
            raise _shape_error("bends", bends, "(bends,)")
        _check_range("phi", phi, math.pi, "rad")
        _check_range("power", power, 1.0, "of full power")
        states = self.metadata.states
        _check_range("bends", bends, max(len(states) - 1, 1) if states else math.pi,
                     "(a state's number)" if states else "rad")  # fmt: skip
        bend = np.tile(bends.astype(np.float32), (len(phi), 1))
        feeds = {"phi": phi.astype(np.float32), "power": power.astype(np.float32), "bend": bend}
        if len(self.material):
            feeds[MATERIAL] = np.tile(self.material.astype(np.float32), (len(phi), 1))
        try:
            parts = [
                self._session.run(list(OUTPUTS), {k: v[i : i + _BATCH] for k, v in feeds.items()})
                for i in range(0, len(phi), _BATCH)
            ]
        except failures() as error:
            raise failed(self.file, error) from None
        outputs = {name: np.concatenate([part[i] for part in parts])
                   for i, name in enumerate(OUTPUTS)}  # fmt: skip
        _check_outputs(self.metadata, outputs, self.file)
        return outputs

    def transport_table(self, phi: Array, bends: Array | None = None) -> TransportTable:
        """Return the transport at direction nodes ``phi`` ``(phi_node,)`` rad.

        Light is linear: as many fibers are lit per run as there are channels, each in one of its
        own, at a power that clips nothing; where transport has an axis of channels, each run
        lights one fiber in all of them. ``se`` is one standard deviation of the model's error of
        single cells; the background's is that of its site's facets, relatively.

        Arguments:
            phi: ascending nodes in [0, pi].
            bends: ``(bend,)`` rad (default: the scene's).
        """
        phi = as_numbers(phi, "phi", ModelError)
        if phi.ndim != 1 or not len(phi):
            raise _shape_error("phi", phi, "(phi_node,)")
        given: Any = self.metadata.scene_bends if bends is None else bends
        bends = as_numbers(given, "bends", ModelError)
        fibers, limit = self.metadata.fibers, self.metadata.metric.count_max
        channels, by_channel = len(self.metadata.channels), self.metadata.by_channel
        at_once = 1 if by_channel else channels
        runs, number = math.ceil(fibers / at_once), np.arange(fibers)
        lit = np.zeros((runs, fibers, channels))
        lit[number // at_once, number, slice(None) if by_channel else number % channels] = 1.0
        directions = np.repeat(phi, runs)[:, None].repeat(fibers, axis=1)
        power = 1.0
        while True:
            outputs = self.run(directions, np.tile(lit, (len(phi), 1, 1)) * power, bends)
            if max(outputs["counts"].max(), outputs["background"].max()) < limit:
                break
            power /= 4.0

        def cells(name: str) -> Array:
            """Return ``(fiber, phi_node, bend, site[, facet][, channel])`` of an output."""
            value = outputs[name].astype(np.float64)
            if by_channel:
                value = value.reshape(len(phi), fibers, *value.shape[1:])
            else:
                value = np.moveaxis(value, -1, 1)
                value = value.reshape(len(phi), runs * channels, *value.shape[2:])[:, :fibers]
            return value.swapaxes(0, 1) / (self.exposure * power)

        transport, spread, background = map(cells, ("counts", "counts_spread", "background"))
        return TransportTable(
            T=transport,
            se=spread,
            phi=phi,
            exposure=self.exposure,
            lam=self.lam,
            scene_hash=self.scene_hash,
            level=self.level,
            effort=self.effort,
            bends=bends,
            background=background,
            background_se=background * (spread / transport).mean(axis=4),
        )


def family_hash(scene: Scene, names: tuple[str, ...]) -> str:
    """Return a hash that scenes share which differ in the quantities ``names`` alone."""
    from render.scene import unchecked

    layer = scene.diffuser
    for name in names:
        layer = layer.with_free(name, 1.0) if layer is not None else None
    return unchecked(scene, {"diffuser": layer}).hash


def _session(content: bytes, metadata: ModelMetadata, file: Path, threads: int | None) -> Any:
    """Return the session of a model that is used, after it has replayed its golden pair."""
    if threads is not None:
        as_whole(threads, "threads", ModelError, least=1)
    session = open_session(content, file, threads)
    golden = replay(session, file)
    if golden is not None:
        _check_outputs(metadata, golden, file)
    return session


def _check_outputs(
    metadata: ModelMetadata, outputs: dict[str, np.ndarray], file: Path | None
) -> None:
    """Refuse outputs of another shape than the description says, from which all else follows.

    Raises:
        ModelError: names the output.
    """
    designs, bends = outputs["metric"].shape[:2] if outputs["metric"].ndim == 3 else (0, 0)
    seen, channels = (designs, bends, metadata.sites), len(metadata.channels)
    shapes = {
        "counts": (*seen, metadata.facets, channels),
        "counts_spread": (*seen, metadata.facets, channels),
        "background": (*seen, channels),
        "metric": seen,
        "score": (designs,),
        "domain_excess": (designs,),
    }
    for name, shape in shapes.items():
        if outputs[name].shape != shape:
            raise ModelError(
                f"{file or 'the model'} gives {name} of shape {outputs[name].shape}, and describes "
                f"{shape}: take a fresh copy of the model",
                field=name,
            )


def _foreign(file: Path, metadata: ModelMetadata, scene_hash: str) -> ModelError:
    return ModelError(
        f"{file} is a model of another scene ({metadata.scene}, hash {metadata.scene_hash}), "
        f"allowed: hash {scene_hash}; train one with `tactilux train`",
        field="scene_hash",
    )


def _shape_error(name: str, value: Array, allowed: str) -> ModelError:
    return ModelError(
        f"{name} has shape {value.shape}, allowed: {allowed}: give one row per design", field=name
    )


def _check_range(name: str, value: Array, high: float, unit: str) -> None:
    bad = ~((value >= 0.0) & (value <= high * (1 + 1e-7)))
    if not bad.any():
        return
    worst = float(value[bad].flat[0])
    degrees = unit == "rad" and worst > high
    hint = "; if these are degrees, convert them with numpy.radians" if degrees else ""
    raise ModelError(
        f"{name} = {worst:g} {unit}, allowed: 0 to {high:.6g}{hint or '; correct the input'}",
        field=name,
    )
