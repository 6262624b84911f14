"""Where lamps sit: scenes that list the places to choose from, and the sensor that a design is."""

from optimize.placement.built_scene import built_scene, unsaid_powers
from optimize.placement.moved_lamps import (
    moved_lamps,
    moved_sentence,
    reads_worse,
    refined_sentence,
)
from optimize.placement.part_lamps import parts_sentence
from optimize.placement.refined_places import RefinedPlaces, refined_places
from optimize.placement.searched_scene import (
    PLACES,
    SearchSpace,
    candidates_of,
    ending_in,
    searched_scene,
    with_places,
)
