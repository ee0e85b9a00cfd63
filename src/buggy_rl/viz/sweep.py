"""A picture of a sweep: its trials in their order, and the best settings with further seeds."""

from collections.abc import Mapping, Sequence

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from buggy_rl.policies.sweep import Ended
from buggy_rl.viz.style import COLOURS, FAINT, tidy

LOOKS = {"complete": ("o", COLOURS[1]), "pruned": ("x", FAINT)}


def sweep_figure(trials: Sequence[Ended], seeds: Mapping[str, Sequence[float]]) -> Figure:
    """Left: best validation of each trial. Right: each setting's seeds, mean and sd.

    Args:
        trials: With at least one validation each, or failed.
        seeds: Setting -> waypoints on the validation paths, one a seed.
    """
    picture, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
    for state, (marker, colour) in LOOKS.items():
        shown = [trial for trial in trials if trial.state == state and trial.curve]
        best = [max(trial.curve) for trial in shown]
        left.plot([t.number for t in shown], best, marker, color=colour, label=state)
    left.set(xlabel="trial", ylabel="waypoints, validation paths", title="Search, one seed")
    left.legend()
    for place, values in enumerate(seeds.values()):
        right.plot([place] * len(values), values, "o", color=FAINT, markersize=4)
        deviation = np.std(values, ddof=1) if len(values) > 1 else 0.0
        right.errorbar(
            place + 0.15, np.mean(values), deviation, fmt="o", color=COLOURS[1], capsize=4
        )
    right.set_xticks(range(len(seeds)), list(seeds), rotation=20)
    right.set(title="Further seeds, mean and sd")
    tidy(left)
    tidy(right)
    return picture
