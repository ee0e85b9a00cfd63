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

from buggy_rl.config import from_command_line, made_by, plain, run, save_run

SCHEMA = "buggy_rl.study.config:WholeStudyConfig"


def main() -> None:
    """Trains every model that does not exist yet."""
    fresh = "fresh=true" in sys.argv
    arguments = [a for a in sys.argv[1:] if a != "fresh=true"]
    config = from_command_line(__doc__, SCHEMA, arguments).of_simulators

    import torch

    from buggy_rl.files import load_torch, save_torch
    from buggy_rl.identification.study import ModelRunConfig, load_drives, model_file, model_runs
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.models.factory import load_about, make_model, save_model
    from buggy_rl.models.training import SCHEMA as CHECKPOINT
    from buggy_rl.models.training import Training, asked
    from buggy_rl.question import refuse_another, schema
    from buggy_rl.run_log import RunLog
    from buggy_rl.study.model_media import model_bundles

    torch.set_num_threads(config.threads)
    drives = load_drives(config.data, tqdm.write, config.car)
    for name, model_config, training_config in model_runs(config):
        file = model_file(config, name)
        checkpoint = file.with_suffix(".checkpoint")
        now = asked(model_config, training_config, drives.training, drives.validation)
        half_done = {**now, "schema": schema(CHECKPOINT)}
        about = {
            "dt": drives.training[0].dt,
            "training": plain(training_config),
            "drives": [r.name for r in drives.training + drives.validation],
            "question": now,
        }
        remedy = "fresh=true trains it again"
        if file.exists() and not fresh:
            refuse_another(load_about(file)[1].get("question"), now, str(file), remedy)
            print(f"{name}: {file} is there already")
            continue
        torch.manual_seed(training_config.seed)
        model = make_model(model_config)
        run = Training(model, drives.training, drives.validation, training_config)
        resume = checkpoint.exists() and not fresh
        if resume:
            state = load_torch(checkpoint)
            refuse_another(state.pop("question", None), half_done, str(checkpoint), remedy)
            run.load_state_dict(state)
        bar = tqdm(run.run(), name, total=training_config.epochs, initial=run.epoch, unit="epoch")
        folder, own = file.with_suffix(""), ModelRunConfig(model_config, training_config)
        logged = {**made_by(), **plain(own)}
        at = run.epoch if resume else None
        with closing(RunLog(folder, "epoch", logged, config.wandb, at)) as log:
            for metrics in bar:
                bar.set_postfix_str(f"validation {metrics['validation_loss']:.4f}")
                log.add(metrics)
                log.write()
                save_torch(checkpoint, {**run.state_dict(), "question": half_done})
            save_model(model, model_config, file, about)
            save_run(own, folder)
            if config.media:
                width = 1 if training_config.preparation == "raw" else training_config.filter_width
                picture = folder / "bundles.png"
                model_bundles(file, width, drives.validation[0], picture)
                log.add({"epoch": run.epoch}, {"bundles": picture})
                log.write()
        checkpoint.unlink(missing_ok=True)
    save_run(config, Path(config.output) / "models")


if __name__ == "__main__":
    run(main)
