"""Filters of films against Mitsuba's own, and what a film holds in each of its formats."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import pytest

SAMPLES = 1 << 20


def film(mono: ModuleType, **parts: Any) -> Any:
    sides = {"width": 9, "height": 7, "crop_width": 6, "crop_height": 5, "crop_offset_x": 2}
    return mono.load_dict({"type": "hdrfilm", "pixel_format": "luminance", **sides, **parts})


FILTERS = [{"type": "gaussian"}, {"type": "gaussian", "stddev": 0.8}, {"type": "tent"},
           {"type": "tent", "radius": 1.7}, {"type": "box"}]  # fmt: skip


@pytest.mark.parametrize("rfilter", FILTERS, ids=str)
def test_samples_that_count_for_one_pixel_make_the_picture_that_mitsubas_filter_makes(
    mono: ModuleType, rfilter: dict[str, Any]
) -> None:
    from render.integrators.film import PixelFilter

    held = film(mono, rfilter=rfilter)
    rng = np.random.default_rng(1)
    x, y, number = rng.random((3, SAMPLES)).astype(np.float32) * np.float32([[6], [5], [1]])
    value = mono.Float(x * x + 3 * (y > 2))
    # ---- Mitsuba: all pixels within the filter's radius, over the sum of their weights ----
    held.prepare([])
    block, one = held.create_block(), mono.Float(1.0)
    block.put(mono.Point2f(x + 2, y), [value, value, value, one + dr.zeros(mono.Float, SAMPLES)])
    held.put_block(block)
    truth = np.array(held.develop())[..., 0]
    # ---- Ours: the same samples once more, in reverse, as the other sample of each lane ----
    places, numbers = [], []
    for order in (1, -1):
        there = np.ascontiguousarray(np.stack([x, y, number])[:, ::order])
        places.append(mono.Point2f(there[0], there[1]))
        numbers.append(mono.Float(there[2]))
    values = np.array(value, dtype=np.float64)
    found = PixelFilter(held).pixels(places, numbers)
    for order, (pixel, weight) in zip((1, -1), found, strict=True):
        sums = np.bincount(np.array(pixel), values[::order] * np.array(weight), minlength=30)
        np.testing.assert_allclose(sums.reshape(5, 6) * 30 / SAMPLES, truth, rtol=0.03)
        assert sums.sum() * 30 / SAMPLES == pytest.approx(truth.sum(), rel=5e-3)


@pytest.mark.parametrize("size", ["float16", "float32"])
def test_a_film_holds_the_last_picture_and_its_further_channels(
    mono: ModuleType, size: str, tmp_path: Path
) -> None:
    from render.integrators.film import store_picture

    held = film(mono, component_format=size)
    rng = np.random.default_rng(2)
    for _ in range(2):
        picture = rng.random((5, 6, 2))
        store_picture(held, picture, ["standard_error.Y"])
        for found in (held.develop(), held.bitmap()):
            np.testing.assert_allclose(np.array(found), picture, rtol=1e-5)
        held.write(str(tmp_path / "held.exr"))
        written = np.array(mono.Bitmap(str(tmp_path / "held.exr")))
        np.testing.assert_allclose(written, picture, rtol=1e-3, atol=1e-6)
