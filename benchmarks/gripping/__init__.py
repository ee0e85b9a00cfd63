"""Parts of grip.py: the simulators, and the way that lost."""
