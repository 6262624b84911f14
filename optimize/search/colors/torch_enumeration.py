"""The enumeration of all color assignments by torch, for machines with a GPU."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from optimize.design import Colors
from optimize.search.colors.enumeration import Enumeration
from render.errors import TactiluxError
from render.metric import clip_counts, design_score, site_metric

if TYPE_CHECKING:
    from optimize.scoring.metric_kernel import Single

COUNTS_AT_ONCE = {"cpu": 4_000_000, "cuda": 400_000_000}
"""Counts held at once, by type of device."""


def torch_enumeration(device: str) -> type[Enumeration]:
    """Return the enumeration that runs on ``device``, for example ``cuda``, ``cuda:1``, ``cpu``.

    Raises:
        TactiluxError: torch does not know the device, or it is not there.
    """
    import torch

    try:
        chosen = torch.device(device)
        torch.zeros(1, device=chosen)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise TactiluxError(
            f"torch cannot use the device {device!r} ({reason}): leave --device out to search on "
            "the processor",
            field="device",
        ) from None

    class TorchEnumeration(Enumeration):
        """One task at a time, its tile on the device; scores by `render.metric` in float32."""

        def __init__(self, *args: Any, **kwargs: Any) -> None:
            """Upload middles and suffixes."""
            super().__init__(*args, **kwargs)

            def up(values: np.ndarray) -> torch.Tensor:
                return torch.as_tensor(np.ascontiguousarray(values), device=chosen)

            blocks = np.moveaxis(self._blocks, -1, 1)
            suffixes = blocks.reshape(-1, *blocks.shape[2:])[: self.suffixes]
            shape = (self.bends, -1, *suffixes.shape[2:])
            self._tile = (
                up(self._middle).reshape(self.middles, 1, *self._shaped(shape)),
                up(suffixes).reshape(1, self.suffixes, *self._shaped(shape)),
            )
            self._fibers_used = tuple(map(up, self._used))

        def _shaped(self, shape: tuple[int, ...]) -> tuple[int, ...]:
            cells = self._middle.shape[1]
            return (self.bends, cells // self.bends, *shape[2:])

        def workers(self) -> int:
            """Return one: the device works in parallel by itself."""
            return 1

        def best_of_tile(
            self, base: Single, free: Colors, keep: int, threshold: np.float32
        ) -> tuple[Single, Colors]:
            """Return the best assignments of the tile, as the kernel does."""
            middle, suffix = self._tile
            start = torch.as_tensor(base, device=chosen).reshape(middle.shape[2:])
            free_fibers = torch.as_tensor(free, device=chosen) - self._fibers_used[0]
            size = suffix[0].numel()
            step = max(1, COUNTS_AT_ONCE[chosen.type if chosen.type == "cuda" else "cpu"] // size)
            parts = []
            for first in range(0, self.middles, step):
                counts = clip_counts(start + middle[first : first + step] + suffix, self.config)
                score = design_score(site_metric(counts, self.lam, self.config), self.config).score
                unused = free_fibers[first : first + step, None] - self._fibers_used[1]
                parts.append(torch.where((unused >= 0).all(dim=-1), score, -torch.inf))
            scores = torch.cat(parts).reshape(-1)
            best, codes = torch.topk(scores, min(keep, len(scores)))
            kept = best > float(threshold)
            return best[kept].cpu().numpy(), codes[kept].cpu().numpy().astype(np.int64)

    return TorchEnumeration
