"""Picture and film of a policy in training."""

from pathlib import Path

import matplotlib.pyplot as plt
import torch

from buggy_rl.figures.policies import policies_figure
from buggy_rl.policies.evaluation.drives import ShowPoliciesConfig, policy_panels
from buggy_rl.visual.film.film import director, frames
from buggy_rl.visual.film.options import RenderConfig
from buggy_rl.visual.film.source import RenderSource
from buggy_rl.visual.film.video import write_video

COURSE = "infinity"  # turns both ways
FILM = {"size": [320, 240], "fps": 12.5, "seconds": 6.0, "samples": 0}


def policy_media(policy: str | Path, folder: Path, steps: int) -> dict[str, Path]:
    """Draws and films a policy in the simulator it is trained in, beside pure pursuit.

    Random states are left as they are.

    Args:
        policy: Its file.
        folder: Of the pictures.
        steps: Of training so far, for their names.

    Returns:
        `trajectories`, a .png, and `film`, a .gif.
    """
    folder.mkdir(parents=True, exist_ok=True)
    label = f"{steps:,} steps"
    picture, film = folder / f"trajectories_{steps}.png", folder / f"film_{steps}.gif"
    with torch.random.fork_rng():
        shown = list(policy_panels(ShowPoliciesConfig(policies={label: str(policy)}, car="")))
        figure = policies_figure(shown)
        figure.savefig(picture, dpi=80)
        plt.close(figure)
        config = RenderConfig(
            what=str(policy),
            ghost="pure_pursuit",
            names=[label, "pure pursuit"],
            course=COURSE,
            output=str(film),
            **FILM,
        )
        says = director(RenderSource(config).tracks(), config.picture)
        write_video(frames(says, says.times(config.fps), config.picture), film, config.fps)
    return {"trajectories": picture, "film": film}
