"""LED boards over a serial line, one protocol per file."""
