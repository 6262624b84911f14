"""Degrees of rendered designs, freed of render noise, with error bars.

Noise of renders is no noise of the camera: it stays the same when a reader is taught, and looks
like places and normals that a smooth map cannot follow. So the plain figure is too high, by about
a constant over the number of replicates: the jackknife takes that away as it does for S (see
`jackknife`), on the closed forms, which are smooth and draw nothing.

Where noise is more than what facets differ by, that constant is none. There a model's colors M,
which have no noise, are a control variate: of the light R of renders the error is
``f(M) + f'(M) (R - M)``, linear in R and so free of bias by noise. It misses the curvature of f
over what M is off by, which is drawn. Of both estimates that with the shorter error bar is taken;
that of the jackknife counts as no shorter than its correction, which fails where it is large.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from optimize.design import Array
from optimize.objectives import READERS, ReaderName
from optimize.readers.camera_model import CameraModel
from optimize.readers.expected_error import ExpectedError
from optimize.readers.model_colors import ModelColors
from optimize.readers.named_readers import expected_error
from optimize.scoring import (
    JackknifeEstimate,
    jackknife_parts,
    normal_factor,
)
from render.scene import Scene


@dataclass(frozen=True, eq=False)
class RenderedDegrees:
    """One reader's expected errors on designs that were rendered together, in degrees.

    Arguments:
        errors: of every design.
        differences: error of design j minus that of design i, by ``(i, j)``, i < j.
    """

    errors: tuple[JackknifeEstimate, ...]
    differences: Mapping[tuple[int, int], JackknifeEstimate]

    def difference(self, first: int, second: int) -> JackknifeEstimate:
        """Return the error of the second design minus that of the first."""
        if first < second:
            return self.differences[first, second]
        return -self.differences[second, first]


def rendered_degrees(
    scene: Scene,
    colors: Array,
    camera: CameraModel | None = None,
    readers: Sequence[ReaderName] = READERS,
    model: ModelColors | None = None,
) -> dict[ReaderName, RenderedDegrees]:
    """Return what ``readers`` miss on designs rendered together.

    ``colors`` ``(replicate, design, B, S, facet + 1, C)`` are counts of facets and untouched pad at
    the scene's exposure, not clipped, of all designs with common seeds. A ``model`` of the same
    designs helps where they are noisy.
    """
    count = colors.shape[1]
    pairs = list(combinations(range(count), 2))
    # Terms apart: what is left of their biases may cancel in a difference by chance.
    signs = np.concatenate([np.eye(count), *(np.eye(count)[[j]] - np.eye(count)[[i]]
                                             for i, j in pairs)])  # fmt: skip
    found: dict[ReaderName, RenderedDegrees] = {}
    for name in readers:
        error = expected_error(name, scene, camera or CameraModel.of(scene))
        made = jackknife_parts(lambda mean, of=error: signs * of.degrees(mean), colors)  # type: ignore[misc]
        if model is not None:
            others = _by_model(error, colors, model, signs)
            made = [
                replace(other, plain=one.plain)
                if other.se < max(one.se, abs(one.value - one.plain))
                else one
                for one, other in zip(made, others, strict=True)
            ]
        found[name] = RenderedDegrees(
            tuple(made[:count]), dict(zip(pairs, made[count:], strict=True))
        )
    return found


def _by_model(
    error: ExpectedError, colors: Array, model: ModelColors, signs: Array
) -> list[JackknifeEstimate]:
    """Return the parts ``signs`` ``(part, design)`` of the errors, on a line through the model."""
    found = [error.slopes(one) for one in model.colors]
    start, slopes = np.array([one[0] for one in found]), np.stack([one[1] for one in found])

    def line(seen: Array) -> Array:
        return np.asarray(start + (slopes * (seen - model.colors)).sum(axis=(-4, -3, -2, -1)))

    shifted = model.colors + model.errors
    drawn = np.array([signs @ (error.degrees(off) - line(off)) for off in shifted])
    bias = np.abs(drawn.mean(axis=0)) + normal_factor(0.9) * drawn.std(axis=0)
    values = line(colors) @ signs.T
    return [
        JackknifeEstimate(float(one.mean()), float(one.mean()), one, float(off))
        for one, off in zip(values.T, bias, strict=True)
    ]
