"""What the reference lines show for any material: drawn for some materials, smooth in between.

The preview is physical in the material (its slab response is a random walk in it) but takes
seconds per material, far too long for a fit. So it is run for materials that fill the range
evenly (Sobol), each with random numbers of its own, and a polynomial of the second degree in the
material is fitted to the logarithm of the light at every point; the regression averages the
random walks' noise. Leaving each material out in turn gives the error of all this.
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hw.calibration.fiber_images import fiber_images
from hw.calibration.material import HIGH, LOW, Material
from hw.calibration.reference_lines import reference_lines
from hw.camera.projection import pixels_of
from hw.errors import CalibrationError
from render.arrays import Array
from render.errors import TableError
from render.files import read_npz, read_or_drop, write_npz
from render.scene.schema import Scene

VERSION = 4
MATERIALS, RAYS = 32, 100_000
COLUMNS, ROWS = 120, 200
DEGREE = 2
EXPONENTS = np.array(
    [e for e in itertools.product(range(DEGREE + 1), repeat=4) if sum(e) <= DEGREE]
)


@dataclass(frozen=True, eq=False)
class MaterialTable:
    """Log light at the reference lines as a polynomial in the material.

    Arguments:
        key: hash of the scene's geometry, directions and bends.
        phi: ``(fiber,)`` rad; bends: ``(bend,)`` rad.
        coefficients: ``(term, bend, fiber, point)``; NaN where the camera sees nothing.
        left_out: ``(material, bend, fiber, point)`` errors of log light at materials left out.
        materials: ``(material, 4)``.
    """

    key: str
    phi: Array
    bends: Array
    coefficients: Array
    left_out: Array
    materials: Array

    def log_light(self, material: Array) -> Array:
        """Return log radiance per unit power, ``(bend, fiber, point)``, for ``(4,)`` numbers."""
        return np.asarray(np.tensordot(terms(material[None])[0], self.coefficients, axes=1))

    def scatter(self) -> Array:
        """Return the rms error ``(bend,)`` of the shape of log light at a material left out."""
        shape = self.left_out - np.nanmean(self.left_out, axis=-1, keepdims=True)
        return np.asarray(np.sqrt(np.nanmean(shape**2, axis=(0, 2, 3))))


def material_table(
    scene: Scene,
    phi: Array,
    bends: Array,
    *,
    folder: Path,
    materials: int = MATERIALS,
    rays: int = RAYS,
    progress: Callable[[int, int], None] | None = None,
) -> MaterialTable:
    """Return the table, from ``folder`` or drawn now; interrupted work goes on where it stood.

    Arguments:
        scene: whose own material does not matter.
        phi: ``(fiber,)`` rad.
        bends: ``(bend,)`` rad.
        folder: where tables and their parts are kept.
        materials: how many are drawn.
        rays: light paths for each.
        progress: called with materials done and all of them.
    """
    key = table_key(scene, phi, bends, materials, rays)
    whole = folder / f"materials-{key}.npz"
    if whole.exists():
        return load_table(whole)
    least = len(EXPONENTS) + 8
    if materials < least:
        raise CalibrationError(
            f"{materials} materials are too few for a polynomial of {len(EXPONENTS)} terms, "
            f"allowed: at least {least}",
            field="materials",
            value=materials,
            allowed=f"at least {least}",
        )
    chosen = sobol_materials(materials)
    pixels = line_pixels(scene, bends, ROWS, COLUMNS)
    parts = folder / f"materials-{key}"
    drawn = []
    for number, material in enumerate(chosen):
        own = Material.from_array(material).put_into(scene)
        path = parts / f"{number:03d}.npz"
        kept = read_or_drop(path, "log_light")
        if kept is None:
            light = line_light(own, phi, bends, pixels=pixels, rays=rays, seed=1000 + number)
            with np.errstate(divide="ignore"):
                kept = {"log_light": np.where(light > 0, np.log(light), np.nan)}
            write_npz(path, kept)
        drawn.append(kept["log_light"])
        if progress:
            progress(number + 1, materials)
    table = _fitted(key, phi, bends, chosen, np.stack(drawn))
    arrays = {name: np.asarray(value) for name, value in vars(table).items()}
    # Half the precision is plenty for errors, and a third of the file.
    small = {"coefficients": np.float32, "left_out": np.float16}
    write_npz(whole, arrays | {name: arrays[name].astype(kind) for name, kind in small.items()})
    for part in parts.glob("*.npz"):
        part.unlink()
    parts.rmdir()
    return table


def load_table(path: Path) -> MaterialTable:
    """Return the table in ``path``.

    Raises:
        TableError: damaged, or something else.
    """
    arrays = read_npz(path)
    names = {"key", "phi", "bends", "coefficients", "left_out", "materials"}
    if set(arrays) != names or len(arrays["coefficients"]) != len(EXPONENTS):
        raise TableError(
            f"{path} is no table of materials: delete it, and it is made again", field="materials"
        )
    floats: dict[str, Array] = {name: arrays[name].astype(np.float64) for name in names - {"key"}}
    return MaterialTable(key=str(arrays["key"]), **floats)


def table_key(
    scene: Scene, phi: Array, bends: Array, materials: int = MATERIALS, rays: int = RAYS
) -> str:
    """Return a hash of everything the table depends on: not of the scene's own material."""
    return design_key(VERSION, scene, phi, bends, materials, rays)


def design_key(version: int, scene: Scene, phi: Array, bends: Array, *details: object) -> str:
    """Return a hash of what all rigs of a design share, at any material, and of ``details``."""
    neutral = Material.from_array(np.sqrt(LOW * HIGH) + 0.01).put_into(scene)
    content = [version, neutral.hash, np.round(phi, 9).tolist(), np.round(bends, 9).tolist(),
               *details]  # fmt: skip
    return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


def sobol_materials(count: int) -> Array:
    """Return ``count`` materials ``(material, 4)`` that fill the range, scattering by its log."""
    from scipy.stats import qmc

    unit = qmc.Sobol(4, scramble=True, rng=np.random.default_rng(1)).random_base2(
        int(np.ceil(np.log2(count)))
    )[:count]
    return _from_unit(2 * unit - 1)


def line_pixels(scene: Scene, bends: Array, rows: int, columns: int) -> Array:
    """Return where the reference lines are in an image, ``(bend, fiber, point, 2)``, else NaN."""
    lines = reference_lines(scene)
    points = lines.on_pad
    found = [pixels_of(scene, float(bend), points.reshape(-1, 2), rows, columns) for bend in bends]
    return np.stack(found).reshape(len(bends), *points.shape)


def line_light(
    scene: Scene, phi: Array, bends: Array, *, pixels: Array, rays: int, seed: int
) -> Array:
    """Return radiance per unit power at the reference lines, ``(bend, fiber, point)``.

    Drawn by the preview for the scene's own material; NaN where the camera sees nothing.
    """
    images = fiber_images(scene, phi, bends, columns=COLUMNS, rows=ROWS, rays=rays, seed=seed)
    return np.stack(
        [
            [sample(image, place) for image, place in zip(*both, strict=True)]
            for both in zip(images, pixels, strict=True)
        ]
    )


def sample(image: Array, pixels: Array) -> Array:
    """Return ``image`` ``(row, column[, channel])`` at ``pixels`` ``(n, 2)``, NaN where they are.

    Linear between the middles of pixels.
    """
    from scipy.ndimage import map_coordinates

    seen = np.isfinite(pixels[:, 0])
    place = np.where(seen[:, None], pixels, 0.0).T[::-1] - 0.5
    layers = image[..., None] if image.ndim == 2 else image
    found = np.stack(
        [
            map_coordinates(layers[..., k].astype(np.float64), place, order=1, mode="nearest")
            for k in range(layers.shape[-1])
        ],
        axis=-1,
    )
    found = np.where(seen[:, None], found, np.nan)
    return np.asarray(found[:, 0] if image.ndim == 2 else found)


def _fitted(key: str, phi: Array, bends: Array, materials: Array, drawn: Array) -> MaterialTable:
    """Return the least-squares polynomial and its leave-one-out errors."""
    basis = terms(materials)
    seen = np.isfinite(drawn).all(axis=0)
    values = np.where(seen, drawn, 0.0).reshape(len(drawn), -1)
    inverse = np.linalg.pinv(basis)
    coefficients = inverse @ values
    # The residual of a material left out is the plain one over 1 - leverage.
    leverage = np.einsum("mt,tm->m", basis, inverse)
    left_out = (values - basis @ coefficients) / (1 - leverage)[:, None]
    shape = drawn.shape[1:]
    hidden: Array = np.where(seen, 0.0, np.nan)
    return MaterialTable(
        key,
        phi,
        bends,
        np.asarray(coefficients, dtype=np.float64).reshape(-1, *shape) + hidden,
        np.asarray(left_out, dtype=np.float64).reshape(-1, *shape) + hidden,
        materials,
    )


def terms_slope(material: Array) -> Array:
    """Return the terms' derivatives ``(4, term)`` by the values of one material ``(4,)``."""
    unit = _to_unit(material[None])[0]
    scale = 2 / (HIGH - LOW)
    scale[0] = 2 / np.log(HIGH[0] / LOW[0]) / material[0]
    rows = []
    for index in range(4):
        lower = EXPONENTS.copy()
        lower[:, index] = np.maximum(lower[:, index] - 1, 0)
        rows.append(scale[index] * EXPONENTS[:, index] * np.prod(unit**lower, axis=1))
    return np.stack(rows)


def terms(materials: Array) -> Array:
    """Return the polynomial's terms ``(material, term)`` of ``(material, 4)``."""
    unit = _to_unit(materials)
    return np.asarray(np.prod(unit[:, None, :] ** EXPONENTS[None], axis=-1))


def _to_unit(materials: Array) -> Array:
    scaled = [np.log(materials[:, 0]), *materials.T[1:]]
    ends = np.stack([LOW, HIGH])
    ends[:, 0] = np.log(ends[:, 0])
    return np.stack(
        [2 * (x - low) / (high - low) - 1 for x, low, high in zip(scaled, *ends, strict=True)],
        axis=-1,
    )


def _from_unit(unit: Array) -> Array:
    low, high = LOW.copy(), HIGH.copy()
    low[0], high[0] = np.log(low[0]), np.log(high[0])
    found = low + 0.5 * (unit + 1) * (high - low)
    found[:, 0] = np.exp(found[:, 0])
    return np.asarray(found)
