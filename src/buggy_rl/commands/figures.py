r"""Draws the figures of a study, each as svg and png.

    python scripts/figures.py configs/sample.yaml
    python scripts/figures.py configs/sample.yaml draw=bundles,signals folder=figures
    python scripts/figures.py configs/sample.yaml draw=learning,policies \
        'learning.runs.learned=[runs/policies/learned_0,runs/policies/learned_1]' \
        policies.policies.learned=runs/policies/learned_0/best.pt

docs/simulators.md says what each shows. A figure whose data are not there is skipped, and the
command that makes them is printed.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Draws one figure after the other."""
    config = from_command_line(__doc__, "buggy_rl.visual.study.figures:FiguresConfig")

    import torch

    from buggy_rl.figures.style import write_figure
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.visual.study.figures import FIGURES, MissingError

    torch.set_num_threads(config.threads)
    unknown = sorted(set(config.draw) - set(FIGURES))
    if unknown:
        raise ValueError(f"draw={unknown}: the figures are {', '.join(FIGURES)}")
    folder = Path(config.folder or Path(config.output) / "figures")
    with tqdm(config.draw or FIGURES, "drawing", unit="figure") as bar:
        for name in bar:
            bar.set_postfix_str(name)
            try:
                write_figure(FIGURES[name](config), folder / name)
            except MissingError as error:
                tqdm.write(f"{name} is skipped: {error}")
    print(f"written: {', '.join(sorted(file.name for file in folder.glob('*.png')))} in {folder}")


if __name__ == "__main__":
    run(main)
