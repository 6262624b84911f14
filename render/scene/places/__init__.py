"""Where lamps may sit that a search places: rails of some kinds, the places on them, and images."""

from render.scene.places.candidates import (
    MOST_CANDIDATES,
    Room,
    candidate_problems,
    candidates_on,
    lamp_problems,
    misfits,
    usual_rails,
)
from render.scene.places.mirror import SIGNS, Mirror, image_of, images
from render.scene.places.rail_places import CandidateLamp, Place, RailPlaces, rail_places
from render.scene.places.search_section import KeepOut, LampCount, Rail, Search
