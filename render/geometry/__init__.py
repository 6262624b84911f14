"""Where everything is: pad, fibers, facets and camera at any bend."""

from render.geometry.bending import bend_frames, bend_points, curvature, unbend_points
from render.geometry.holder import ALONG, FiberHolder, lit_offset
from render.geometry.indenter import (
    SHADOW_LENGTH,
    BoltHead,
    Imprint,
    ball,
    body_of_file,
    bolt,
    imprint_depth,
    pyramids,
)
from render.geometry.layout import (
    FiberPoses,
    facet_normals,
    facets,
    fiber_edges,
    fiber_poses,
    flat_fiber_poses,
    flat_sites,
    mirrored_fibers,
    pyramid,
)
from render.geometry.microfacets import Floats, fresnel, sample_rough_face
from render.geometry.refraction import distance_to_coating, refract_into_pad
from render.geometry.symmetry import is_mirror_symmetric, mirror_image, with_mirror_images
from render.geometry.visibility import (
    FacetMasks,
    camera_origin,
    camera_rays,
    facet_masks,
    pixel_directions,
)
