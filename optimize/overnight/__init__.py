"""The overnight job: renders, refits, searches and verifies through the night, and survives it."""
