"""Transport behind a diffuser by compiled photon walks, converged: exit field times gathering.

Shares with the preview what a fiber end emits and how the camera mixes facets, nothing in between:
no slab response, no image method, no radiosity of its patches on edges.
"""
