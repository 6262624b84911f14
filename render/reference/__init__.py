"""The reference, level 2: transport tables and pictures with error bars."""
