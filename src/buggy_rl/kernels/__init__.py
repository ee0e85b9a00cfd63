"""Functions that are compiled ahead of time: many small operations in one call."""
