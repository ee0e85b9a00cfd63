"""Trains the models of a study on its recordings.

    python scripts/train_models.py configs/sample.yaml
    python scripts/train_models.py configs/dart.yaml configs/dart_models.yaml only=gru

Writes OUTPUT/models/NAME.pt, its losses by epoch in the folder NAME as CSV and for TensorBoard, and
a checkpoint after every epoch: run again, it resumes bit for bit and skips finished models
(`fresh=true` trains them again). `wandb=true` tells Weights & Biases, `media=true` adds rollouts.
"""

import sys
from contextlib import closing
from pathlib import Path

from buggy_rl.config import from_command_line, plain, run, save_run

SCHEMA = "buggy_rl.study.config:WholeStudyConfig"


def main() -> None:
    """Trains every model that does not exist yet."""
    fresh = "fresh=true" in sys.argv
    arguments = [a for a in sys.argv[1:] if a != "fresh=true"]
    config = from_command_line(__doc__, SCHEMA, arguments).of_simulators

    import torch

    from buggy_rl.files import save_torch
    from buggy_rl.identification.study import ModelRunConfig, load_drives, model_file, model_runs
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.models.factory import load_about, make_model, save_model
    from buggy_rl.models.training import Training
    from buggy_rl.run_log import RunLog
    from buggy_rl.study.model_media import model_bundles

    torch.set_num_threads(config.threads)
    save_run(config, Path(config.output) / "models")
    drives = load_drives(config.data, tqdm.write, config.car)
    for name, model_config, training_config in model_runs(config):
        file = model_file(config, name)
        checkpoint = file.with_suffix(".checkpoint")
        about = {
            "dt": drives.training[0].dt,
            "training": plain(training_config),
            "drives": [r.name for r in drives.training + drives.validation],
        }
        if file.exists() and not fresh:
            if load_about(file) != (plain(model_config), about):
                raise ValueError(
                    f"{file} was trained with another config; fresh=true trains it again"
                )
            print(f"{name}: {file} is there already")
            continue
        torch.manual_seed(training_config.seed)
        model = make_model(model_config)
        run = Training(model, drives.training, drives.validation, training_config)
        resume = checkpoint.exists() and not fresh
        if resume:
            run.load_state_dict(torch.load(checkpoint, weights_only=True))
        bar = tqdm(run.run(), name, total=training_config.epochs, initial=run.epoch, unit="epoch")
        folder, own = file.with_suffix(""), ModelRunConfig(model_config, training_config)
        save_run(own, folder)
        with closing(RunLog(folder, "epoch", plain(own), config.wandb, resume)) as log:
            for metrics in bar:
                bar.set_postfix_str(f"validation {metrics['validation_loss']:.4f}")
                log.add(metrics)
                log.write()
                save_torch(checkpoint, run.state_dict())
            save_model(model, model_config, file, about)
            if config.media:
                width = 1 if training_config.preparation == "raw" else training_config.filter_width
                picture = folder / "bundles.png"
                model_bundles(file, width, drives.validation[0], picture)
                log.add({"epoch": run.epoch}, {"bundles": picture})
                log.write()
        checkpoint.unlink(missing_ok=True)


if __name__ == "__main__":
    run(main)
