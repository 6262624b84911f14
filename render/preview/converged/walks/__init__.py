"""Compiled light paths in the bent block: through the clear pad and in the diffusive layer.

Frame of this room (mm): ``x`` across, ``v = y - pivot``, ``w = thickness - z`` in the world frame
of `render.geometry.bending`: the origin lies on the coating, ``w`` grows towards the camera.
With the coating's curvature kappa, the level ``g = kappa (v^2 + w^2) / 2 + w`` of a point at depth
delta below the coating is ``delta + kappa delta^2 / 2`` at any bend, 0 included; ends of the block
are planes through the bend's axis. So every face is a plane or a quadric, but for a skin that is
not flat, to which rays go in steps (`way_to_skin`).
A flat block may be two clear media, pad over window, which meet at the plane of depth ``bond``.

Paths are analog (a photon lives or dies) but for masking at rough faces.

What is compiled with these paths lives in this room, see `render.compiled`.
"""

from render.preview.converged.walks.backward_paths import find_coating, gather
from render.preview.converged.walks.crossings import (
    BASE,
    END,
    LEFT,
    LOWER,
    NONE,
    OUTER_LEFT,
    OUTER_RIGHT,
    RIGHT,
    START,
    TIP,
    Block,
)
from render.preview.converged.walks.faces import meet_bond, reflect_inside
from render.preview.converged.walks.forward_paths import Receivers, trace_arrivals
from render.preview.converged.walks.layer import FaceGrid, trace_lamp
from render.preview.converged.walks.splitmix import begin_stream, uniform
