"""Finds where a simulator and drives differ: located, named, modelled, proven."""
