"""A page to play with: one HTML file that holds a sensor's light, its score and the way uphill."""

from optimize.play.play_page import MAX_BYTES, PlayPage, inline_digest, write_play
