"""Where a simulator and drives differ: located, named, modelled, proven."""
