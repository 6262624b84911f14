"""A film of Mitsuba's: how a sample counts for pixels, and what the film holds after a render."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array

CELL_STEPS = 256
"""Points of the midpoint rule for what a filter integrates to over one pixel."""


class PixelFilter:
    """A film's reconstruction filter f, by one pixel per sample instead of all within its radius.

    Mitsuba's pixel p is ``sum f(x_i - p) L_i / sum f(x_i - p)`` of samples at ``x_i``, whose
    expectation is ``integral f(x - p) L(x) dx / integral f(x - p) dx`` over the film. A sample goes
    to pixel p with probability ``f(x - p) / sum_q f(x - q)`` (filters are separable, and none of
    them is negative), times that sum over the integral.
    """

    def __init__(self, film: mi.Film) -> None:
        """Tabulate the integrals, which are smaller next to the border of the crop window."""
        self.width, self.height = (int(n) for n in film.crop_size())
        self.filter = film.rfilter()
        self.box = bool(self.filter.is_box_filter())
        self.reach = 0 if self.box else math.ceil(self.filter.radius() + 0.5) - 1
        if not self.box:
            steps = (np.arange(CELL_STEPS) + 0.5) / CELL_STEPS - 0.5
            offsets = np.arange(-self.reach, self.reach + 1)
            points = (offsets[:, None] + steps).ravel().astype(np.float32)
            values = np.array(self.filter.eval(mi.Float(points)), dtype=np.float64)
            cells = values.reshape(len(offsets), -1).mean(axis=1)
            self.columns, self.rows = (self._integrals(cells, n) for n in film.crop_size())

    def _integrals(self, cells: Array, size: int) -> mi.Float:
        """Return the integral of f about each of ``size`` pixels, over all of them.

        ``cells`` are its integrals over a pixel and its neighbors.
        """
        padded = np.convolve(np.ones(size), cells)
        return mi.Float(padded[self.reach : self.reach + size].astype(np.float32))

    def pixel(self, position: mi.Point2f, number: mi.Float) -> tuple[mi.UInt32, mi.Float | float]:
        """Return the pixel, row by row, that samples at ``position`` count for, and their weight.

        ``position`` is in pixels of the crop window; ``number`` is uniform.
        """
        column = dr.minimum(mi.UInt32(dr.maximum(position.x, 0.0)), self.width - 1)
        row = dr.minimum(mi.UInt32(dr.maximum(position.y, 0.0)), self.height - 1)
        if self.box:
            return row * self.width + column, 1.0
        column, across, number = self._drawn(position.x, column, self.columns, number)
        row, along, _ = self._drawn(position.y, row, self.rows, number)
        return row * self.width + column, across * along

    def _drawn(
        self, x: mi.Float, cell: mi.UInt32, integrals: mi.Float, number: mi.Float
    ) -> tuple[mi.UInt32, mi.Float, mi.Float]:
        """Return a pixel near ``x`` in ``cell``, its weight, and a uniform number again."""
        size = dr.width(integrals)
        places = [mi.Int32(cell) + k for k in range(-self.reach, self.reach + 1)]
        values = [
            dr.select((place >= 0) & (place < size), self.filter.eval(x - 0.5 - place), 0.0)
            for place in places
        ]
        total = sum(values[1:], values[0])
        left, chosen, again = number * total, mi.UInt32(cell), mi.Float(number)
        for place, value in zip(places, values, strict=True):
            here = (left >= 0.0) & (left < value)
            chosen = dr.select(here, mi.UInt32(place), chosen)
            again = dr.select(here, left / value, again)
            left -= value
        return chosen, total / dr.gather(mi.Float, integrals, chosen), again


def store_picture(film: mi.Film, picture: Array, further: list[str]) -> None:
    """Let ``film`` hold ``picture (row, column, channel)`` and nothing else.

    Channels are those of the variant, one or three, and those named ``further``.
    """
    colors = picture.shape[-1] - len(further)
    rgb = picture[..., :colors] if colors == 3 else np.repeat(picture[..., :1], 3, axis=-1)
    weight = np.ones_like(picture[..., :1])
    film.prepare(further)
    data = np.concatenate([rgb, weight, picture[..., colors:]], axis=-1).astype(np.float32)
    film.put_block(mi.ImageBlock(mi.TensorXf(data), mi.ScalarPoint2i(film.crop_offset())))
