"""Figures of recordings, simulators and policies, and films of them."""
