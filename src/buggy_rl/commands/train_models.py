"""Trains the models of a study on its recordings.

    python scripts/train_models.py configs/sample.yaml
    python scripts/train_models.py configs/dart.yaml configs/dart_models.yaml only=gru

Writes OUTPUT/models/NAME.pt, its losses by epoch in the folder NAME as CSV and for TensorBoard, and
a checkpoint after every epoch: run again, it resumes bit for bit and skips finished models
(`fresh=true` trains them again). `wandb=true` tells Weights & Biases, `media=true` adds rollouts.
"""

import sys
from contextlib import closing
from functools import partial
from pathlib import Path

from buggy_rl.core.config import from_command_line, run, save_run

SCHEMA = "buggy_rl.visual.study.stages:WholeStudyConfig"


def main() -> None:
    """Trains every model that does not exist yet."""
    fresh = "fresh=true" in sys.argv
    arguments = [a for a in sys.argv[1:] if a != "fresh=true"]
    config = from_command_line(__doc__, SCHEMA, arguments).of_simulators

    import torch

    from buggy_rl.api.training import ModelRun
    from buggy_rl.estimation.fit_study import ModelRunConfig, load_drives, model_file, model_runs
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.visual.study.figures import model_bundles

    torch.set_num_threads(config.threads)
    drives = load_drives(config.data, tqdm.write, config.car)

    def draw(file: Path, width: int) -> dict[str, Path]:
        picture = file.with_suffix("") / "bundles.png"
        model_bundles(file, width, drives.validation[0], picture)
        return {"bundles": picture}

    for name, model, training in model_runs(config):
        own = ModelRunConfig(model, training)
        made = ModelRun(own, drives.training, drives.validation, model_file(config, name), fresh)
        if made.done:
            print(f"{name}: {made.file} is there already")
            continue
        width = 1 if training.preparation == "raw" else training.filter_width
        media = partial(draw, width=width) if config.media else None
        with (
            tqdm(desc=name, total=training.epochs, unit="epoch") as bar,
            closing(made.metrics(config.wandb, media)) as epochs,
        ):
            for metrics in epochs:
                bar.set_postfix_str(f"validation {metrics['validation_loss']:.4f}")
                bar.update(metrics["epoch"] - bar.n)
    save_run(config, Path(config.output) / "models")


if __name__ == "__main__":
    run(main)
