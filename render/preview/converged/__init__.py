"""Converged transport: light of every lamp, followed to every facet by compiled paths.

The preview that the shader draws is truncated: few terms, few heights, one reflection. Here light
is followed by compiled paths until it is absorbed; tens of seconds instead of one.
"""

from render.preview.converged.cache import (
    converged_transport,
    few_paths_transport,
    is_kept,
    narrowest_turning_beam,
    phi_nodes,
    refinements,
)
from render.preview.converged.transport import ConvergedTransport, Effort, task_count, transport_at
