"""The path sampler of transport cells: fiber and facet are extra primary dimensions."""
