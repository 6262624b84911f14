"""Where the samples of a render go, when it is not for all cells alike.

A score of a design is a function of many cells, and some of them move it much more than others. The
variance of a linear function ``sum g x`` of samples that are shared among cells is least when the
share of a cell is proportional to ``|g|`` times the standard deviation of one sample (Neyman 1934);
the same cells in all pads compete for them, so bends differ in their number of samples too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from render.arrays import Array
from render.cells.sample_shares import floored_shares, pad_slots
from render.errors import RenderError
from render.geometry import counted_sites
from render.scene import Scene


@dataclass(frozen=True, eq=False)
class SampleAllocation:
    """Where the samples go; any allocation is unbiased, only the noise differs.

    Arguments:
        shares: ``(bend, site, fiber)``, at least 0, of the pressed pads' samples, which are as
            many as without them; see `render.cells.sample_shares` for the floor beneath. None
            for the usual ones.
        untouched: whether the untouched pads are rendered; no score depends on them. What was not
            rendered is NaN.
    """

    shares: Array | None = None
    untouched: bool = True


EVERYTHING = SampleAllocation()
"""All cells alike, the untouched pads too: for tables that anything may be asked of."""
PRESSED = SampleAllocation(untouched=False)
"""What scores of designs depend on."""


@dataclass(frozen=True, eq=False)
class PadShares:
    """What one pressed pad gets.

    Arguments:
        effort: its samples, in units of the usual number.
        slots: of every fiber at every site (``RenderJob.slots``).
    """

    effort: float
    slots: tuple[tuple[int, ...], ...]


def pad_shares(scene: Scene, bends: Array, shares: Array) -> list[PadShares]:
    """Return what the pad at each of ``bends`` (rad) gets of ``shares`` ``(bend, site, fiber)``.

    Raises:
        RenderError: the shares are not of these bends, the sites that count and the fibers, or one
            of them is below 0 or not finite.
    """
    allowed = (len(bends), len(counted_sites(scene)), scene.lamp_count)
    if shares.shape != allowed or not (np.isfinite(shares) & (shares >= 0)).all():
        raise RenderError(
            f"shares of shape {shares.shape}, least {shares.min():g}, allowed: {allowed} "
            "(bend, site, fiber) and finite numbers from 0",
            field="allocation",
        )
    mixed = floored_shares(scene, bends, shares)
    return [
        PadShares(len(bends) * float(pad.sum()), tuple(map(tuple, pad_slots(pad).tolist())))
        for pad in mixed
    ]
