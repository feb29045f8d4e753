"""Transfer as graphics hardware takes it: some bytes per vertex, and few functions for each of at most 255 caps."""
