"""The preview, level 0: a rasterized approximation of transport, without a display."""
