"""LED boards over a serial line, one protocol per file, and the lights of the fibers."""
