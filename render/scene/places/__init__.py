"""Where lamps may sit that a search places: rails along edges, and the places on them."""

from render.scene.places.candidates import (
    MOST_CANDIDATES,
    CandidateLamp,
    candidate_problems,
    candidates_on,
    lamp_problems,
    usual_rails,
)
from render.scene.places.search_section import KeepOut, Rail, Search
