"""Draws the reference paths: random ones for training and validation, lap, infinity, circle, tight.

    python scripts/show_paths.py
    python scripts/show_paths.py output=runs/mine.png paths.kind=file paths.file=track.csv

Prints the number of paths of each set, their spacing and their smallest turning radius.
"""

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Makes and draws every kind of path."""
    config = from_command_line(__doc__, "buggy_rl.task.paths.making:ShowPathsConfig")

    from buggy_rl.figures.policies import paths_figure
    from buggy_rl.figures.style import save_figure
    from buggy_rl.task.paths.making import path_sets

    sets = path_sets(config)
    print(f"{'paths':12} {'number':>6} {'waypoints':>9} {'spacing':>8} {'tightest turn':>14}")
    for name, paths in sets.items():
        radius = 1 / float(paths.largest_curvature.max())
        spacing, count = float(paths.spacing.mean()), int(paths.count.max())
        print(f"{name:12} {len(paths):6} {count:9} {spacing:6.3f} m {radius:12.2f} m")
    save_figure(paths_figure(sets, config.shown, config.waypoints), config.output, dpi=110)


if __name__ == "__main__":
    run(main)
