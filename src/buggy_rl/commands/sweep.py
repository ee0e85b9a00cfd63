"""Searches settings of PPO: proposed by Optuna, trained as independent jobs, confirmed by seeds.

    python scripts/sweep.py configs/sweep.yaml "policy=[configs/ppo.yaml,engine.simulator=MODEL.pt]"
    python scripts/sweep.py configs/sweep.yaml launcher=ray cluster.address=auto workers=16

TPE proposes, the median rule ends trials early by their validations, and the best settings are
trained again with further seeds beside what the config has. Writes OUTPUT/trials.csv, sweep.csv,
sweep.png. Started again, it goes on where it stopped. docs/policies.md says how to read the result.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run, save_run


def main() -> None:
    """Runs the trials that are missing, then the confirmations."""
    config = from_command_line(__doc__, "buggy_rl.policies.training.sweep:SweepConfig")

    import pandas as pd

    from buggy_rl.figures.policies import sweep_figure
    from buggy_rl.jobs.bar import run_with_bar, tqdm
    from buggy_rl.policies.training.sweep import Sweep, confirmed

    sweep = Sweep(config, Path(__file__).with_name("train_policy.py"))
    with tqdm(desc="trials", total=config.trials, initial=len(sweep.ended()), unit="trial") as bar:
        for trial in sweep.run():
            best = max(trial.curve, default=float("nan"))
            tqdm.write(f"trial {trial.number}: {trial.state}, {best:.1f} waypoints")
            bar.update()
    trials = sweep.ended()
    rows = [
        {"trial": t.number, "state": t.state, "waypoints": max(t.curve, default=None), **t.values}
        for t in trials
    ]
    pd.DataFrame(rows).to_csv(config.folder / "trials.csv", index=False)

    jobs = sweep.confirmations()
    every = [job for own in jobs.values() for job in own]
    run_with_bar("further seeds", every, "step", config.workers, config)
    seeds = confirmed(jobs)
    settings = {f"trial_{t.number:04d}": t.values for t in trials}
    table = pd.DataFrame(
        [
            {
                "setting": name,
                "mean": pd.Series(values).mean(),
                "sd": pd.Series(values).std(),
                "seeds": len(values),
                **settings.get(name, {}),
            }
            for name, values in seeds.items()
        ]
    )
    table.to_csv(config.folder / "sweep.csv", index=False)
    save_run(config, config.folder)
    sweep_figure(trials, seeds).savefig(config.folder / "sweep.png", dpi=130)
    print(f"{table.to_string(index=False)}\nwritten: {config.folder / 'sweep.csv'}, sweep.png")


if __name__ == "__main__":
    run(main)
