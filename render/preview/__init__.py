"""The preview: a rasterized approximation of transport, without a display."""

from render.preview.bonded import with_bonded_window
from render.preview.diffuser.cache import cache_folder, fiber_end_of, slab_of
from render.preview.diffuser.response import SlabResponse, compute_response
from render.preview.lights import point_lights
from render.preview.preview import Preview
