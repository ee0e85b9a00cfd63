"""Sealed blind tests: physics is concealed in cars, diagnosed, and the answers are scored."""
