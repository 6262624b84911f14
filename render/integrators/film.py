"""A film of Mitsuba's: how a sample counts for pixels, and what the film holds after a render."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np

from render.arrays import Array

CELL_STEPS = 64
"""Points of the midpoint rule for what a filter integrates to over one pixel, to 3e-5 of it."""


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
            # One by one they are literals, for which nothing is compiled.
            values = [self.filter.eval(mi.Float(x))[0] for x in (offsets[:, None] + steps).flat]
            cells = np.reshape(values, (len(offsets), -1)).mean(axis=1)
            # About each column, then each row.
            padded = [np.convolve(np.ones(n), cells)[self.reach :][:n] for n in film.crop_size()]
            self.integrals = mi.Float(np.concatenate(padded).astype(np.float32))

    @dr.syntax
    def pixels(
        self, positions: list[mi.Point2f], numbers: list[mi.Float]
    ) -> list[tuple[mi.UInt32, mi.Float]]:
        """Return the pixel, row by row, that each of two samples counts for, and its weight.

        ``positions`` are in pixels of the crop window; ``numbers`` are uniform. What is written
        once, for both samples, axes and all pixels near, is compiled once.
        """
        found = [(mi.UInt32(0), mi.Float(0.0))] * 2
        axis, number = mi.UInt32(0), mi.Float(0.0)
        while dr.hint(axis < 4, exclude=[positions, numbers]):
            first, column = axis < 2, (axis & 1) == 0
            pixel, weight = found[1]
            position = dr.select(first, *positions)
            x = dr.select(column, position.x, position.y)
            size = dr.select(column, mi.UInt32(self.width), mi.UInt32(self.height))
            chosen = dr.minimum(mi.UInt32(dr.maximum(x, 0.0)), size - 1)
            along = mi.Float(1.0)
            number = dr.select(column, dr.select(first, *numbers), number)
            if not self.box:
                chosen, total, number = self._drawn(x, chosen, size, number)
                place = chosen + dr.select(column, 0, self.width)
                along = total / dr.gather(mi.Float, self.integrals, place)
            pixel = dr.select(column, chosen, chosen * self.width + pixel)
            weight = dr.select(column, along, along * weight)
            found = [dr.select(first, (pixel, weight), found[0]), (pixel, weight)]
            axis += 1
        return found

    @dr.syntax
    def _drawn(
        self, x: mi.Float, cell: mi.UInt32, size: mi.UInt32, number: mi.Float
    ) -> tuple[mi.UInt32, mi.Float, mi.Float]:
        """Return a pixel near ``x`` in ``cell``, what f sums up to there, and a number again."""
        around = 2 * self.reach + 1
        step, total, left = mi.Int32(0), mi.Float(0.0), mi.Float(0.0)
        chosen, again = mi.UInt32(cell), mi.Float(number)
        # All are summed up; then one is drawn.
        while dr.hint(step < 2 * around, exclude=[x, cell, size, number]):
            draws = step >= around
            place = mi.Int32(cell) + step - dr.select(draws, around, 0) - self.reach
            value = self.filter.eval(x - 0.5 - place)
            value = dr.select((place >= 0) & (place < mi.Int32(size)), value, 0.0)
            left = dr.select(step == around, number * total, left)
            here = draws & (left >= 0.0) & (left < value)
            chosen = dr.select(here, mi.UInt32(place), chosen)
            again = dr.select(here, left / value, again)
            left -= value
            total += dr.select(draws, 0.0, value)
            step += 1
        return chosen, total, again


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
