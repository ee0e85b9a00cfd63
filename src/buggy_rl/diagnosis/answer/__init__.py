"""The answer: what is named, with which numbers, and what speaks for it."""
