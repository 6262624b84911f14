"""The transport table: linear radiance per facet and unit fiber power, the shared currency.

Axes everywhere: ``(fiber, phi_node, bend, site, facet)``; the untouched pad (background) is
``(fiber, phi_node, bend, site)``. Where materials depend on the color channel, both have one more
axis at the end, ``channel``. Unit: radiance at the camera in 1/(mm^2 sr) per unit radiant
power of the fiber. float64, errors are one standard deviation of the mean.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path

import numpy as np

from render.arguments import as_kind, as_numbers, as_one_of, as_path, as_target, refuse
from render.arrays import Array
from render.chebyshev import interpolation_weights
from render.errors import TableError
from render.files import read_npz, write_npz
from render.levels import EFFORTS, LEVELS, REFERENCE, level_name, read_level

OPTIONAL = ("background", "background_se", "half_difference")
"""Arrays that a table may be without."""


@dataclass(frozen=True)
class TransportTable:
    """Transport on a grid of fiber directions and bends, with its standard errors.

    Arguments:
        T: ``(fiber, phi_node, bend, site, facet[, channel])``.
        se: standard errors of ``T``, of the same shape.
        phi: ``(phi_node,)`` rad, distinct.
        bends: ``(bend,)`` rad; empty when a foreign table does not say.
        background: ``(fiber, phi_node, bend, site[, channel])`` or None.
        background_se: its standard errors, of the same shape, or None.
        half_difference: ``(fiber, phi_node, bend, site, facet + 1[, channel])``, the untouched pad
            last: T plus and minus it are the means over two halves of the light paths, which share
            none; None where nobody kept them apart.
        exposure: counts per unit of ``sum_f power_f T_f``.
        lam: weight of M_phi in eq. (4.6).
        scene_hash: the scene that it was made for; empty for foreign tables.
        level: one of `LEVELS`; effort: one of `EFFORTS`, None where the level has none.
    """

    T: Array
    se: Array
    phi: Array
    exposure: float
    lam: float
    scene_hash: str = ""
    level: str = REFERENCE
    bends: Array = field(default_factory=lambda: np.zeros(0))
    background: Array | None = None
    background_se: Array | None = None
    half_difference: Array | None = None
    effort: str | None = None

    def __post_init__(self) -> None:
        """Check shapes and values: a table with missing cells is refused, never patched."""
        as_one_of(self.level, LEVELS, "level", TableError)
        as_one_of(self.effort, (None, *EFFORTS), "effort", TableError)
        for name in ("T", "se", "phi", "bends", *OPTIONAL):
            given = getattr(self, name)
            if given is not None or name not in OPTIONAL:
                object.__setattr__(self, name, as_numbers(given, name, TableError))
        for name in ("exposure", "lam"):
            as_kind(getattr(self, name), Real, name, "a number", TableError)
        as_kind(self.scene_hash, str, "scene_hash", "a text", TableError)
        if self.T.ndim not in (5, 6) or 0 in self.T.shape:
            raise TableError(
                f"T has shape {self.T.shape}, allowed: five non-empty axes "
                "(fiber, phi_node, bend, site, facet), and a sixth of channels where materials "
                "depend on the channel",
                field="T",
            )
        pads = self.T.shape[:4] + self.T.shape[5:]
        expected = {
            "se": self.T.shape,
            "phi": self.T.shape[1:2],
            "bends": self.T.shape[2:3],
            "background": pads,
            "background_se": pads,
            "half_difference": (*self.T.shape[:4], self.T.shape[4] + 1, *self.T.shape[5:]),
        }
        given = {
            name: shape
            for name, shape in expected.items()
            if getattr(self, name) is not None and (name != "bends" or self.bends.size)
        }
        for name, shape in given.items():
            if getattr(self, name).shape != shape:
                raise TableError(
                    f"{name} has shape {getattr(self, name).shape}, allowed: {shape}", field=name
                )
        for name in ("T", *given):
            bad = ~np.isfinite(getattr(self, name))
            if bad.any():
                raise TableError(
                    f"{name} has {int(bad.sum())} non-finite cells, the first at "
                    f"{tuple(int(i) for i in np.argwhere(bad)[0])}: render them again",
                    field=name,
                )
        if len(np.unique(self.phi)) < len(self.phi):
            raise TableError("phi has equal nodes, allowed: distinct directions", field="phi")
        if not (np.isfinite(self.exposure) and self.exposure > 0):
            raise TableError(
                f"exposure = {self.exposure}, allowed: finite and above 0", field="exposure"
            )
        if not (np.isfinite(self.lam) and self.lam >= 0):
            raise TableError(f"lam = {self.lam}, allowed: finite and at least 0", field="lam")

    def __repr__(self) -> str:
        """Return in one line which level it is of, and its axes."""
        axes = ("fibers", "directions", "bends", "sites", "facets", "channels")
        sizes = ", ".join(f"{n} {axis}" for n, axis in zip(self.T.shape, axes, strict=False))
        level = level_name(self.level, self.effort)
        return f"<TransportTable, {level}, scene {self.scene_hash or 'unknown'}: {sizes}>"

    @property
    def with_pad(self) -> Array:
        """``T`` with the untouched pad behind the facets, ``(..., facet + 1[, channel])``.

        Raises:
            TableError: the table has no background.
        """
        if self.background is None:
            raise TableError(
                "the table has no background, allowed: one that knows the untouched pad, which "
                "readers see too; name the scene that it was made for",
                field="background",
            )
        return np.concatenate([self.T, np.expand_dims(self.background, 4)], axis=4)

    @property
    def by_channel(self) -> bool:
        """Whether the materials depend on the color channel."""
        return self.T.ndim == 6

    def at(self, phi: Array) -> Array:
        """Return T ``(fiber, bend, site, facet[, channel])`` at ``phi`` ``(fiber,)`` rad.

        A table of one node knows no other direction and returns that node for every ``phi``.
        """
        phi = as_numbers(phi, "phi", TableError)
        if phi.shape != self.T.shape[:1]:
            raise TableError(
                f"phi has shape {phi.shape}, allowed: ({len(self.T)},), one per fiber", field="phi"
            )
        low, high = self.phi.min(), self.phi.max()
        if len(self.phi) > 1 and not ((phi >= low) & (phi <= high)).all():
            raise TableError(
                f"phi = {np.asarray(phi)} rad leaves the table, allowed: {low:g} to {high:g} rad",
                field="phi",
            )
        weights = interpolation_weights(self.phi, phi)
        return np.asarray(np.einsum("fj,fjbsk...->fbsk...", weights, self.T))

    def at_bends(self, bends: Array) -> TransportTable:
        """Return the table at ``bends`` ``(bend,)`` rad, interpolated, without its background."""
        bends = as_numbers(bends, "bends", TableError)
        if bends.ndim != 1 or not bends.size or not self.bends.size or not np.isfinite(bends).all():
            known = ", ".join(f"{bend:g}" for bend in self.bends) or "none, as the table has none"
            refuse(
                bends, "bends", f"a list of finite bends; those of the table: {known}", TableError
            )
        weights = interpolation_weights(self.bends, bends)
        T, se = (np.einsum("ab,fjbsk...->fjask...", weights, part) for part in (self.T, self.se))
        return replace(
            self,
            T=T,
            se=se,
            bends=bends,
            background=None,
            background_se=None,
            half_difference=None,
        )

    def save(self, path: str | Path) -> None:
        """Write the table as ``.npz`` without pickles, first beside ``path``, then renamed."""
        path = as_target(path, "path", TableError)
        arrays: dict[str, np.ndarray] = {
            "T": self.T,
            "se": self.se,
            "phi": self.phi,
            "bends": self.bends,
            "exposure": np.array(self.exposure),
            "lam": np.array(self.lam),
            "scene_hash": np.array(self.scene_hash),
            "level": np.array(self.level),
        }
        if self.effort is not None:
            arrays["effort"] = np.array(self.effort)
        for name in OPTIONAL:
            if getattr(self, name) is not None:
                arrays[name] = getattr(self, name)
        write_npz(path, arrays)


def mean_table(tables: Sequence[TransportTable], samples: Sequence[float]) -> TransportTable:
    """Return the mean of independent tables with background, weighted by their ``samples``.

    Its standard errors follow from theirs: ``se^2 = sum_i (w_i se_i)^2``.
    """
    weights = [each / sum(samples) for each in samples]

    def mean(name: str) -> Array:
        parts = zip(weights, tables, strict=True)
        return np.asarray(sum(weight * getattr(part, name) for weight, part in parts))

    def error(name: str) -> Array:
        parts = zip(weights, tables, strict=True)
        squares = sum((weight * getattr(part, name)) ** 2 for weight, part in parts)
        return np.asarray(np.sqrt(np.asarray(squares)))

    apart = any(part.half_difference is None for part in tables)
    return replace(
        tables[0],
        T=mean("T"),
        se=error("se"),
        background=mean("background"),
        background_se=error("background_se"),
        half_difference=None if apart else mean("half_difference"),
    )


def load_table(path: str | Path) -> TransportTable:
    """Return the table stored in ``path``.

    Raises:
        TableError: when the file is missing, is not such a table, or has bad cells.
        ReadError: when memory, handles or rights do not suffice to read it.
    """
    path = as_path(path, "path", TableError)
    arrays = read_npz(path)
    missing = {"T", "phi", "exposure", "lam"} - set(arrays)
    if missing:
        raise TableError(f"{path} is not a transport table: it has no {', '.join(sorted(missing))}")
    numbers = {
        name: _numbers(path, name, arrays[name])
        for name in ("T", "se", "phi", "bends", *OPTIONAL, "exposure", "lam")
        if name in arrays
    }
    for name in ("exposure", "lam"):
        if numbers[name].size != 1:
            raise TableError(f"{path}: {name} has {numbers[name].size} values, allowed: one")
    level, effort = (str(arrays[name]) if name in arrays else None for name in ("level", "effort"))
    level, effort = read_level(level or REFERENCE, effort)
    return TransportTable(
        T=numbers["T"],
        se=numbers.get("se", np.zeros_like(numbers["T"])),
        phi=numbers["phi"],
        bends=numbers.get("bends", np.zeros(0)),
        exposure=float(numbers["exposure"].item()),
        lam=float(numbers["lam"].item()),
        scene_hash=str(arrays.get("scene_hash", "")),
        level=level,
        effort=effort,
        **{name: numbers.get(name) for name in OPTIONAL},
    )


def _numbers(path: Path, name: str, stored: np.ndarray) -> Array:
    if stored.dtype.kind not in "fiu":
        raise TableError(f"{path}: {name} holds {stored.dtype}, allowed: real numbers", field=name)
    return np.asarray(stored, dtype=np.float64)
