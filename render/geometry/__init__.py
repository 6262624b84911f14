"""Where everything is: pad, fibers, facets and camera at any bend."""

from render.geometry.bending import bend_frames, bend_points, curvature, unbend_points
from render.geometry.camera_rays import (
    camera_axes,
    camera_origin,
    camera_rays,
    half_view,
    lens_directions,
    lens_positions,
    pixel_directions,
    pixel_positions,
)
from render.geometry.chart import SkinChart
from render.geometry.height_map import HeightMap
from render.geometry.holder import ALONG, PLAY, FiberHolder
from render.geometry.indenter import (
    SHADOW_LENGTH,
    BoltHead,
    Imprint,
    ball,
    bolt,
    imprint_depth,
    pyramids,
    smoothed_skin,
    straight_edge,
)
from render.geometry.lamp_poses import (
    LOWER,
    FiberPoses,
    MirrorTwins,
    fiber_edges,
    fiber_poses,
    flat_fiber_poses,
    mirror_twins,
)
from render.geometry.layout import declared_sites, facet_normals, facets, pyramid, site_frames
from render.geometry.microfacets import Floats, fresnel, sample_rough_face
from render.geometry.probes import PROBES, probe
from render.geometry.refraction import aim_at, distance_to_coating, refract_into_pad
from render.geometry.seen_sites import (
    camera_coverage,
    check_seen,
    counted_sites,
    flat_sites,
    seen_rule,
    seen_targets,
)
from render.geometry.states import StateChart, in_state
from render.geometry.symmetry import (
    camera_is_symmetric,
    is_mirror_symmetric,
    mirror_image,
    states_are_symmetric,
    with_mirror_images,
)
from render.geometry.visibility import FacetMasks, facet_masks
