r"""Films a recording, a simulator or a policy: mp4, gif or png.

    python scripts/render.py what=data/sample/sample_00.csv output=runs/drive.mp4
    python scripts/render.py what=data/sample/sample_00.csv ghost=mujoco restart=2
    python scripts/render.py what=runs/fitted.yaml ghost=runs/repaired.yaml \
        recording=data/sample/sample_00.csv start=5
    python scripts/render.py what=runs/policy/best.pt ghost=pure_pursuit course=infinity
    python scripts/render.py what=my_simulator.py:factory camera=top output=runs/mine.gif
    python scripts/render.py what=data/sample/sample_00.csv ghost=mujoco live=true

The ghost is the translucent car. A simulator drives under the commands of a recording, where one is
named, and else pure pursuit drives it round the course. Without OpenGL it is drawn from above.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Makes the tracks, then the film."""
    config = from_command_line(__doc__, "buggy_rl.visual.film.options:RenderConfig")

    import torch

    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.visual.film.film import director, frames
    from buggy_rl.visual.film.source import RenderSource
    from buggy_rl.visual.film.video import check_ending, write_video

    torch.set_num_threads(config.threads)
    check_ending(config.output)
    says = director(RenderSource(config).tracks(), config.picture)
    if config.live:
        from buggy_rl.visual.viewer.control_page import play

        return play(says, config.playback, config.live)
    times = says.times(config.fps, config.playback).tolist()
    if Path(config.output).suffix.lower() == ".png":
        times = [says.moment(config.moment)]
    made = frames(says, tqdm(times, "rendering", unit="frame"), config.picture, tqdm.write)
    write_video(made, config.output, config.fps)
    print(f"written: {config.output} ({len(times)} frames, {says.tracks[0].duration:.1f} s driven)")


if __name__ == "__main__":
    run(main)
