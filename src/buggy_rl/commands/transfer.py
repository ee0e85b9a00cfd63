"""Draws cars that change, trains policies for them in simulators of nine kinds, and drives them.

    python scripts/transfer.py configs/transfer.yaml
    python scripts/transfer.py configs/transfer.yaml stages=evaluate,page
    python scripts/transfer.py configs/transfer.yaml only=1,2
    python scripts/transfer.py configs/transfer.yaml cars=2 control_every=2 seeds=0
    python scripts/transfer.py output=FOLDER stages=page

Arms: the simulator as given, repaired, fitted anew, learned, with random parameters, repaired with
random parameters, the changed car itself, with another car's repair, and repaired with training
continued; src/buggy_rl/proof/transfer/arms.py has the table. Stages: drive (the hash of the secret
is published before), fit, learn, diagnose, train, evaluate, page. Writes OUTPUT/drives.csv,
cars.csv, and from these alone transfer.md and transfer.png; the layout of OUTPUT stands in
src/buggy_rl/proof/transfer/plan.py. A stage does nothing twice: stop it, start it.
"""

from pathlib import Path

from buggy_rl.commands import command_line
from buggy_rl.core.config import from_command_line, run, save_run


def main() -> None:
    """Runs the stages of the config."""
    config = from_command_line(__doc__, "buggy_rl.proof.transfer.plan:TransferConfig")
    if {*config.stages} - {"page"}:
        _stages(config)
        save_run(config, Path(config.output))
    if "page" in config.stages:
        from buggy_rl.proof.transfer.page import write_page

        file = write_page(config, command_line(without="stages="))
        print(file.read_text().split("![")[0] + f"written: {file}")


def _stages(config) -> None:
    """All stages before the page."""
    from buggy_rl.jobs.bar import run_with_bar
    from buggy_rl.proof.cases.secret import secret_of
    from buggy_rl.proof.transfer.jobs import (
        diagnosis_jobs,
        fit_jobs,
        model_jobs,
        record,
        recorded,
        training_jobs,
    )
    from buggy_rl.proof.transfer.simulators import write_simulators

    cases, scripts = config.drawn(secret_of(config.store)), Path(__file__).parent
    if "drive" in config.stages:
        left = {car: case for car, case in cases.items() if not recorded(config, car)}
        if left:
            print(f"driving cars {', '.join(left)}, all at once ...", flush=True)
            record(config, left)
    for stage, listed in (("fit", fit_jobs), ("learn", model_jobs), ("diagnose", diagnosis_jobs)):
        if stage in config.stages:
            run_with_bar(stage, listed(config, scripts), "car", config.workers, config)
    if "train" in config.stages:
        write_simulators(config, cases)
        for title, started in (("train", False), ("train on", True)):
            jobs = training_jobs(config, scripts, started)
            run_with_bar(title, jobs, "step", config.workers, config)
    if "evaluate" in config.stages:
        _evaluate(config, cases)


def _evaluate(config, cases) -> None:
    """Drives what is left and writes the tables; shows the secret when every car was driven."""
    from buggy_rl.jobs import results
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.proof.cases.secret import publish_secret
    from buggy_rl.proof.transfer.driving import drive_policies, undriven
    from buggy_rl.proof.transfer.tables import all_driven, write_tables

    left = undriven(config, cases)
    with tqdm(desc="evaluate", total=sum(len(b.policies) for b in left), unit="policy") as bar:
        calls = {"_".join(b.file.with_suffix("").parts[-3:]): (b,) for b in left}
        place = Path(config.output) / "jobs"
        for count in results(drive_policies, calls, place, config.workers, config):
            bar.update(count)
    write_tables(config, cases)
    if all_driven(config):
        publish_secret(config.store)


if __name__ == "__main__":
    run(main)
