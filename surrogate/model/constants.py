"""Constants of the graph: arrays computed in float64, stored as float32 buffers."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import nn

from render.arrays import Array


def store_constants(module: nn.Module, arrays: Mapping[str, Array]) -> None:
    """Register ``arrays`` as float32 buffers of ``module`` under their names."""
    for name, values in arrays.items():
        module.register_buffer(name, torch.as_tensor(values, dtype=torch.float32))
