"""Checks of simulator and recordings before a search."""
