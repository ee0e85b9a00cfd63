"""Measurements of the car's runtime against the simulated car."""
