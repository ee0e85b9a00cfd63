"""A sensor that does not show the motion as it is."""
