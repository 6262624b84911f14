"""A page to play with: one HTML file with a sensor's light, its readers and the way uphill."""

from optimize.play.play_page import MAX_BYTES, PlayPage, inline_digest, write_play
