"""Recordings of drives: reading, checking, resampling, writing."""
