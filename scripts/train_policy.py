"""Trains a policy by PPO to drive along waypoints in any simulator.

    python scripts/train_policy.py configs/ppo.yaml engine.simulator=mujoco output=runs/mujoco
    python scripts/train_policy.py configs/ppo_original.yaml engine.simulator=runs/models/MLP.pt

Writes OUTPUT/best.pt (by the validation paths), last.pt, checkpoint.pt, the resolved config, and
logs as CSV and for TensorBoard. `resume=true` goes on where a run stopped, bit for bit.
"""

import os
from pathlib import Path

from buggy_rl.config import from_command_line, plain, save_run


def main() -> None:
    """Trains until the steps are used up."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before torch: busy waiting ruins 2 cores
    config = from_command_line(__doc__, "buggy_rl.policy_run:PolicyRunConfig")

    import torch
    from tqdm import tqdm

    from buggy_rl.checkpoint import load_checkpoint, save_checkpoint
    from buggy_rl.policy import save_policy
    from buggy_rl.policy_run import (
        new_policy,
        training_environment,
        validate,
        validation_environment,
    )
    from buggy_rl.ppo import PPO, NonFiniteLossError

    torch.set_num_threads(config.threads)
    torch.manual_seed(config.seed)
    folder = Path(config.output)
    save_run(config, folder)
    env, validation = training_environment(config), validation_environment(config)
    policy = new_policy(env, config.policy)
    run, best = PPO(env, policy, config.ppo), -1.0
    if config.resume:
        state = load_checkpoint(folder / "checkpoint.pt")
        best = state.pop("best")
        run.load_state_dict(state)
    loggers, rows = make_loggers(config, folder), []
    batch = config.ppo.cars * config.ppo.batch_steps
    bar = tqdm(total=config.ppo.steps, initial=run.steps, unit="step", unit_scale=True)
    try:
        for metrics in run.run():
            bar.update(batch)
            bar.set_postfix_str(
                f"reward {metrics['reward']:.4f}, {metrics['waypoints']:.1f} closed"
            )
            done, due = run.steps / config.ppo.steps, (run.steps - batch) / config.ppo.steps
            last = run.steps >= config.ppo.steps
            if last or int(done * config.validations) > int(due * config.validations):
                metrics |= validate(validation, policy, config.validation_steps)
                about = {"config": plain(config), "steps": run.steps, **metrics}
                if metrics["validation_waypoints"] > best:
                    best = metrics["validation_waypoints"]
                    save_policy(policy, folder / "best.pt", about)
                save_policy(policy, folder / "last.pt", about)
            rows.append(metrics)
            if last or run.steps // batch % config.checkpoint_batches == 0:
                log(loggers, rows)  # just before the checkpoint, so that a resumed log repeats none
                save_checkpoint({**run.state_dict(), "best": best}, folder / "checkpoint.pt")
    except NonFiniteLossError as error:
        save_checkpoint(error.batch.to_dict(), folder / "failed_batch.pt")
        raise SystemExit(
            f"error: {error}\n(the batch is in {folder / 'failed_batch.pt'})"
        ) from None
    bar.close()
    print(f"{folder / 'best.pt'}: {best:.1f} waypoints on the validation paths")


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
    main()
