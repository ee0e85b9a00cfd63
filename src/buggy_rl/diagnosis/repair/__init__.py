"""The repaired simulator: validated, and the proof of it."""
