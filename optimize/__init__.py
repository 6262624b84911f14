"""Color and direction search, reports, verification and the command line."""
