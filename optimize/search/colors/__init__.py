"""Which LED drives which fiber: one file per search strategy."""
