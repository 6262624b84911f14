"""Light in the diffusive layer: its response to every fiber, by a random walk."""
