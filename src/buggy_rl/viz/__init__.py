"""Figures of recordings, simulators and policies."""
