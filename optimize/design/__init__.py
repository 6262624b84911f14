"""A lighting design: what it is, what may be chosen, and its file."""
