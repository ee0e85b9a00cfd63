"""Trains a policy to drive along waypoints: by PPO in any simulator, or by gradients through one.

    python scripts/train_policy.py configs/ppo.yaml engine.simulator=mujoco output=runs/mujoco
    python scripts/train_policy.py configs/shac.yaml engine.simulator=runs/models/MLP.pt
    python scripts/train_policy.py configs/ppo_original.yaml engine.simulator=runs/models/MLP.pt

Writes OUTPUT/best.pt (by the selection paths), last.pt, checkpoint.pt, the resolved config, and
logs as CSV and for TensorBoard; `wandb=true` tells Weights & Biases, `media=true` adds pictures and
films. `resume=true` goes on where a run stopped, bit for bit; `start=POLICY.pt` begins with its
weights. With `seeds=[0,1,2]` each is a run of
its own in OUTPUT/seed_N, `workers` at a time on any `launcher` (docs/policies.md), OUTPUT/seeds.csv
compares them; started again, it goes on from their checkpoints by itself.
"""

import os
from contextlib import closing
from pathlib import Path

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Trains until the steps are used up."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # before torch: busy waiting ruins 2 cores
    config = from_command_line(__doc__, "buggy_rl.policies.training.seeds:PolicyTrainingConfig")
    if config.seeds:
        return each_seed(config)
    config = config.single

    import torch

    from buggy_rl.api.training import policy_metrics
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.policies.training.run import PolicyRun
    from buggy_rl.policies.training.trainer import NonFiniteLossError

    torch.set_num_threads(config.threads)
    folder = Path(config.output)
    training = PolicyRun(config)
    if training.note:
        print(training.note)
    bar = tqdm(total=config.settings.steps, initial=training.trainer.steps, unit="step",
               unit_scale=True, desc=folder.name)  # fmt: skip
    batches = policy_metrics(training, media if config.media else None)
    try:
        with closing(batches), bar:
            for metrics in batches:
                bar.update(training.batch)
                bar.set_postfix_str(
                    f"reward {metrics['reward']:.3f}, {metrics['waypoints']:.1f} closed"
                )
    except NonFiniteLossError as error:
        file = folder / "failed_batch.pt"
        raise SystemExit(f"error: {error}\n(the batch is in {file})") from None
    print(f"{folder / 'best.pt'}: {training.best:.1f} waypoints on the selection paths")


def each_seed(config) -> None:
    """Trains one policy for each seed and compares them."""
    import pandas as pd

    from buggy_rl.jobs.bar import run_with_bar
    from buggy_rl.policies.training.seeds import seed_jobs, validations

    jobs = seed_jobs(config, Path(__file__))
    run_with_bar(Path(config.output).name, jobs, "step", config.workers, config)
    table = pd.DataFrame(validations([job.folder for job in jobs]))
    file = Path(config.output) / "seeds.csv"
    table.to_csv(file, index=False)
    waypoints = table["validation_waypoints"]
    print(f"{file}: {waypoints.mean():.1f} +- {waypoints.std():.1f} waypoints, {len(table)} seeds")


def media(folder: Path, metrics) -> dict[str, Path]:
    """Pictures and films of the policy just validated."""
    from buggy_rl.visual.policy_media import policy_media

    return policy_media(folder / "last.pt", folder / "media", int(metrics["steps"]))


if __name__ == "__main__":
    run(main)
