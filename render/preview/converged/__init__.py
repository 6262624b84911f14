"""Converged transport T = U H: light that leaves the diffuser, times what a facet gets of it.

The preview that the shader draws is truncated: few terms, few heights, one reflection. Here light
is followed by compiled paths until it is absorbed; tens of seconds instead of one.
"""

from render.preview.converged.cache import NODES, converged_transport, is_kept, limitation
from render.preview.converged.transport import Effort, task_count, transport_at
