"""A simulator's own parameters fitted to recordings; the study and its table."""
