"""Films a recording, a simulator or a policy, with a second one as a translucent ghost.

    python scripts/render.py what=data/sample/sample_00.csv output=runs/drive.mp4
    python scripts/render.py what=drive.csv ghost=fitted.yaml output=runs/drift.gif camera=top
    python scripts/render.py what=policy.pt course=infinity output=runs/policy.mp4

Rendered by MuJoCo where OpenGL works, otherwise drawn from above.
"""

from buggy_rl.config import from_command_line, run


def main() -> None:
    """Writes the film, or shows it."""
    config = from_command_line(__doc__, "buggy_rl.viz.film.film:FilmConfig")

    import torch
    from tqdm import tqdm

    torch.set_num_threads(1)
    if config.live:
        from buggy_rl.viz.film.live import show

        show(config)
        return
    from buggy_rl.viz.film.film import film

    print(f"written: {film(config, tqdm, tqdm.write)}")


if __name__ == "__main__":
    run(main)
