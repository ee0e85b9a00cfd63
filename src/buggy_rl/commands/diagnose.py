"""Says where a simulator and drives differ, what physics is missing, and gives back the simulator.

    python scripts/diagnose.py simulator=fitted.yaml recordings=drives/ output=runs/diagnosis
    python scripts/diagnose.py simulator=my.py:make recordings=new/ baseline=old/ output=runs/d

Writes OUTPUT/diagnosis.json, repaired.yaml (which every script takes as a simulator), report.html.
Interrupted, it goes on where it stopped when it is started again. With `cars=FOLDER` in place of
recordings, every folder in it is one car's recordings: each is diagnosed by itself in OUTPUT/CAR,
`workers` at a time on any `launcher` (docs/policies.md), and OUTPUT/fleet.csv has a row for each.
"""

from pathlib import Path

from buggy_rl.core.config import from_command_line, run


def main() -> None:
    """Diagnoses and writes."""
    config = from_command_line(__doc__, "buggy_rl.diagnosis.run.fleet:FleetConfig")
    if config.cars:
        return each_car(config)
    config = config.single

    from buggy_rl.api.diagnosis import diagnosed
    from buggy_rl.commands.compile import at_first_use
    from buggy_rl.diagnosis.run.maker import own_options
    from buggy_rl.jobs.bar import tqdm

    at_first_use(config.simulator, **own_options(config))
    folder = Path(config.output)
    found = diagnosed(config, config.recordings, config.baseline, tqdm.write, folder)
    for note in found.notes:
        tqdm.write(f"note: {note}")
    print(found)
    names = ("report.html", "diagnosis.json", "repaired.yaml")
    print(f"written: {', '.join(str(folder / name) for name in names)}")


def each_car(config) -> None:
    """Diagnoses every car of a folder and writes one table."""
    import pandas as pd

    from buggy_rl.diagnosis.run.fleet import fleet_jobs, fleet_rows
    from buggy_rl.jobs import cores
    from buggy_rl.jobs.bar import run_with_bar

    jobs, file = fleet_jobs(config, Path(__file__)), Path(config.output) / "fleet.csv"
    try:
        run_with_bar("diagnosing", jobs, "car", config.workers or cores(), config)
    finally:
        table = pd.DataFrame(fleet_rows(jobs))
        table.to_csv(file, index=False)
        print(f"{table.to_string(index=False)}\nwritten: {file}")


if __name__ == "__main__":
    run(main)
