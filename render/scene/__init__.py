"""What a sensor is: the scene file, its quantities, constraints and tolerances."""

from render.scene.camera import MOST_PIXELS, Camera
from render.scene.catalog import (
    Led,
    LedEntry,
    entries_in,
    entries_of,
    known_entries,
    known_leds,
    responses,
    shipped_leds,
)
from render.scene.colors import OFF, RGB, LedColor, Palette
from render.scene.constraints import HOLDER_THICKNESS, Constraints, FixedFiber
from render.scene.faces import Finish
from render.scene.free_ranges import FreeRanges
from render.scene.lamp_profile import Profile
from render.scene.lamps import EDGES, FACES, OUTWARD, RIM_EDGES, Edge, PlacedLamp, Row
from render.scene.places import LampCount, Rail, Search
from render.scene.quantities import Count, Quantity, unchecked
from render.scene.scene_file import as_scene, load_scene, scene_text, shipped_scenes, sources
from render.scene.schema import Scene
from render.scene.sections import CarriedSites, Coating, Window
from render.scene.serialization import scene_content, scene_of
from render.scene.skin import SHAPES, Skin
from render.scene.skin_mesh import MeshHeights
from render.scene.standalone import StandaloneScene, rewritten, save_scene, standalone
from render.scene.states import REST, State
from render.scene.tolerances import Spread, Tolerances
