"""The search for sets of effects, and their probabilities."""
