"""Draws histograms of recorded velocities and commands, before and after mirroring.

    python scripts/show_drives.py configs/sample.yaml

Reads the training recordings of a study; writes OUTPUT/drives.png. No model predicts a range that
is missing here: record it.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Draws the training recordings of a study."""
    config = from_command_line(
        __doc__, "buggy_rl.visual.study.stages:WholeStudyConfig"
    ).of_simulators

    from tensordict import TensorDict

    from buggy_rl.core import keys
    from buggy_rl.estimation.fit_study import load_drives
    from buggy_rl.figures.drives import histogram_figure
    from buggy_rl.figures.style import save_figure
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.recordings.windows import mirror

    drives = load_drives(config.data, tqdm.write, config.car)
    keep = (keys.POSE, keys.VELOCITY, keys.ACTION)
    rows: TensorDict = TensorDict.cat([r.data.select(*keep) for r in drives.training])  # type: ignore[assignment]
    both: TensorDict = TensorDict.cat([rows, mirror(rows)])  # type: ignore[assignment]
    seconds = sum(r.duration for r in drives.training)
    print(f"{len(drives.training)} training recordings, {seconds:.0f} s")
    figure = histogram_figure({"as driven": rows, "and mirrored": both})
    save_figure(figure, Path(config.output) / "drives.png")


if __name__ == "__main__":
    run(main)
