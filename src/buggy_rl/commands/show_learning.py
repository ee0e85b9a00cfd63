r"""Draws learning curves: mean and range of the seeds of each policy.

    python scripts/show_learning.py output=runs/learning.png \
        'runs.learned=[runs/policies/learned_0,runs/policies/learned_1]' \
        'runs.mujoco=[runs/policies/mujoco_0]' drivers.mujoco=runs/drivers/mujoco/drivers.csv

Waypoints closed on the training paths with exploration, and on the validation paths without.
"""

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Reads the logs and draws the curves."""
    config = from_command_line(__doc__, "buggy_rl.policies.training.seeds:ShowLearningConfig")

    from buggy_rl.figures.policies import learning_figure
    from buggy_rl.figures.style import save_figure
    from buggy_rl.policies.training.seeds import curves

    found = curves(config)
    for curve in found:
        if curve.band.empty:
            print(f"{curve.name}: no {curve.metric} yet")
            continue
        last = curve.band.iloc[-1]
        score = "" if curve.score is None else f", pure pursuit {curve.score:.1f}"
        print(
            f"{curve.name}, {curve.metric}: {last['mean']:.1f} ({last['low']:.1f} - "
            f"{last['high']:.1f}) after {curve.band.index[-1]:,} steps{score}"
        )
    save_figure(learning_figure(found), config.output)


if __name__ == "__main__":
    run(main)
