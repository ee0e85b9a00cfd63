"""Trains a policy by PPO to drive along waypoints in any simulator.

    python scripts/train_policy.py configs/ppo.yaml engine.simulator=mujoco output=runs/mujoco
    python scripts/train_policy.py configs/ppo_original.yaml engine.simulator=runs/models/MLP.pt

Writes OUTPUT/best.pt (by the validation paths), last.pt, checkpoint.pt, the resolved config, and
logs as CSV and for TensorBoard. `resume=true` goes on where a run stopped, bit for bit.
"""

import os
from pathlib import Path

from buggy_rl.config import from_command_line, plain, run, save_run


def main() -> None:
    """Trains until the steps are used up."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before torch: busy waiting ruins 2 cores
    config = from_command_line(__doc__, "buggy_rl.policies.run:PolicyRunConfig")

    import torch
    from tqdm import tqdm

    from buggy_rl.policies.ppo import NonFiniteLossError
    from buggy_rl.policies.run import PolicyRun

    torch.set_num_threads(config.threads)
    folder = Path(config.output)
    save_run(config, folder)
    training = PolicyRun(config)
    loggers, rows = make_loggers(config, folder), []
    steps = config.ppo.steps
    bar = tqdm(
        total=steps, initial=training.ppo.steps, unit="step", unit_scale=True, desc=folder.name
    )
    try:
        for metrics in training.metrics():
            bar.update(training.batch)
            bar.set_postfix_str(
                f"reward {metrics['reward']:.3f}, {metrics['waypoints']:.1f} closed"
            )
            rows.append(metrics)
            if training.checkpoint_is_due:
                log(loggers, rows)  # just before the checkpoint, so that a resumed log repeats none
                training.checkpoint()
    except NonFiniteLossError as error:
        file = folder / "failed_batch.pt"
        raise SystemExit(f"error: {error}\n(the batch is in {file})") from None
    bar.close()
    print(f"{folder / 'best.pt'}: {training.best:.1f} waypoints on the validation paths")


def make_loggers(config, folder):
    """CSV and TensorBoard always, Weights & Biases on request."""
    from torchrl.record.loggers.csv import CSVLogger
    from torchrl.record.loggers.tensorboard import TensorboardLogger

    loggers = [CSVLogger("csv", str(folder)), TensorboardLogger("tensorboard", str(folder))]
    if config.wandb:
        from torchrl.record.loggers.wandb import WandbLogger

        mode = os.environ.get("WANDB_MODE", "offline")
        loggers += [WandbLogger("buggy_rl", save_dir=str(folder), mode=mode, config=plain(config))]
    return loggers


def log(loggers, rows) -> None:
    """Writes the rows out and forgets them."""
    for row in rows:
        for logger in loggers:
            for name, value in row.items():
                logger.log_scalar(name, value, step=row["steps"])
    rows.clear()


if __name__ == "__main__":
    run(main)
