r"""Tunes the controllers pure pursuit and Stanley for a simulator and evaluates them in it.

    python scripts/tune_drivers.py engine.simulator=runs/sample/mujoco_fitted.yaml \
        output=runs/drivers/mujoco

Writes OUTPUT/drivers.md, drivers.csv, and the tuned parameters as OUTPUT/pure_pursuit.yaml and
stanley.yaml, which other scripts read.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, plain_values, run, save_run


def main() -> None:
    """Tunes the controllers, evaluates them, prints and saves the tables."""
    config = from_command_line(
        __doc__, "buggy_rl.policies.evaluation.controller_tables:DriverTablesConfig"
    )

    import pandas as pd
    import torch
    import yaml

    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.policies.evaluation.controller_tables import (
        driver_results,
        driver_table,
        tuned_driver,
    )

    torch.set_num_threads(config.threads)
    folder = Path(config.output)
    folder.mkdir(parents=True, exist_ok=True)
    found, best = {}, {}
    for name in config.drivers:
        with tqdm(total=config.rounds * config.steps, desc=f"tuning {name}", unit="step") as bar:
            found[name], trials = tuned_driver(config, name, bar.update)
        best[name] = trials[0]
        (folder / f"{name}.yaml").write_text(
            yaml.safe_dump(plain_values(found[name]), sort_keys=False)
        )
    rows = list(driver_results(config, found, lambda todo: tqdm(todo, "driving", unit="course")))
    text = driver_table(rows, best, config)
    print(f"\n{text}")
    save_run(config, folder)
    (folder / "drivers.md").write_text(text)
    pd.DataFrame([row.row() for row in rows]).to_csv(folder / "drivers.csv", index=False)
    print(f"written: {folder}/drivers.md, drivers.csv, " + ", ".join(f"{n}.yaml" for n in found))


if __name__ == "__main__":
    run(main)
