"""Who drives: policies that are written down rather than learned, one a file."""
