"""Where everything is: pad, fibers, facets and camera at any bend."""
