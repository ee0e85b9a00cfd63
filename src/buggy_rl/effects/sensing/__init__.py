"""Sensors whose measurement differs from the true motion."""
