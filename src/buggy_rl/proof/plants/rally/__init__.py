"""The rally car: a simulated 1:10 electric buggy of drawn numbers, as a plant.

Two tracks, brush tyres with LuGre bristles, motor, gear, differential and clutch, servo and slack,
heave, roll and pitch. Its author wrote equations, numbers, ranges, changes and unknown effects
without having seen this package, its effects or the other plants; they are kept as they were
written, and only names of modules, layout and docstrings are this project's. `plant` is the engine
about it, `textbook` says which of its changes are effects of the textbook, `owner` what the owner
of such a car knows of it.
"""

from buggy_rl.proof.plants.rally.plant import ABILITIES, RallyPlant, make_rally

__all__ = ["ABILITIES", "RallyPlant", "make_rally"]
