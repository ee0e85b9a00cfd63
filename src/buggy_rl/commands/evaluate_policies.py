"""Lets policies drive in both simulators and on the reference car: tables 7.2 to 7.7.

    python scripts/evaluate_policies.py configs/policies.yaml

The original study's printed numbers stand beside ours. Writes OUTPUT/policies.md, policies.csv,
seeds.csv with each seed, and seeds.png, in which each is a point.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run, save_run


def main() -> None:
    """Drives, prints and saves."""
    config = from_command_line(__doc__, "buggy_rl.policies.evaluation.tables:PolicyTablesConfig")

    import pandas as pd
    import torch

    from buggy_rl.figures.policies import seeds_figure
    from buggy_rl.figures.style import save_figure
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.policies.evaluation.drives import car_name
    from buggy_rl.policies.evaluation.tables import mean_interval, policy_results, tables
    from buggy_rl.policies.human_table import human_drives

    torch.set_num_threads(config.threads)
    found = list(policy_results(config, lambda todo: tqdm(todo, "driving", unit="course")))
    human = human_drives(Path(config.human), config.simulators) if config.human else None
    text = tables(found, car_name(config.car), human)
    print(text)
    folder = Path(config.output)
    save_run(config, folder)
    (folder / "policies.md").write_text(text)
    rows = [
        {
            "policy": r.policy,
            "place": r.place,
            "course": r.course,
            **r.scores.means(),
            **dict(zip(("waypoints_low", "waypoints_high"), mean_interval(r.seeds), strict=True)),
        }
        for r in found
    ]
    pd.DataFrame(rows).to_csv(folder / "policies.csv", index=False)
    seeds = [
        {"policy": r.policy, "place": r.place, "course": r.course, "seed": n,
         "waypoints": waypoints, "failed": failed}
        for r in found
        for n, (waypoints, failed) in enumerate(zip(r.seeds, r.failed, strict=True))
    ]  # fmt: skip
    pd.DataFrame(seeds).to_csv(folder / "seeds.csv", index=False)
    save_figure(seeds_figure(found, car_name(config.car)), folder / "seeds.png")


if __name__ == "__main__":
    run(main)
