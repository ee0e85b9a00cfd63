"""Picture of a model just trained."""

from functools import partial
from pathlib import Path

import numpy as np

from buggy_rl import keys
from buggy_rl.identification.open_loop import measured
from buggy_rl.identification.table import Candidate, held_out_segments, judge
from buggy_rl.recordings import Recording
from buggy_rl.task.env import make_simulator
from buggy_rl.viz.bundles import Bundles, bundles_figure

SEGMENTS = 12  # of a bundle; more of them hide one another


def model_bundles(model: Path, filter_width: int, recording: Recording, picture: Path) -> None:
    """Draws open-loop rollouts of a model over a recording.

    Args:
        model: Its file.
        filter_width: Rows of the past mean that its starts are filtered by; 1 for none.
        recording: That it was not trained on.
        picture: The file that is written.
    """
    test = held_out_segments([recording], SEGMENTS)
    name = model.stem
    made, _ = judge(Candidate(name, partial(make_simulator, str(model)), filter_width), test)
    driven = np.asarray(measured(test.segments).get(keys.POSE))
    time = test.segments.dt * np.arange(driven.shape[1])
    rollouts = {name: np.asarray(made.get(keys.POSE))}
    bundles_figure(Bundles(recording.name, time, driven, rollouts)).savefig(picture, dpi=110)
