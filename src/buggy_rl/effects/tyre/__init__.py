"""Tyres that hold less than the simulated ones."""
