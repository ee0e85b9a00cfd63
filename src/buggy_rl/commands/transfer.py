"""Trains policies for cars in which something is concealed, and drives them there.

    python scripts/transfer.py configs/transfer.yaml
    python scripts/transfer.py configs/transfer.yaml stages=evaluate,page
    python scripts/transfer.py configs/transfer.yaml output=runs/quick steps=1000000 seeds=0

Four policies for each car, by one budget of PPO: in MuJoCo as fitted before the change, in MuJoCo
repaired by the diagnosis of two minutes of driving, in a model learned from the same two minutes,
and in MuJoCo with randomised physics. Stages: drive (the two minutes), diagnose, learn, train,
evaluate, page. Writes OUTPUT/transfer.md, transfer.json, transfer.png; the layout of OUTPUT stands
in src/buggy_rl/proof/transfer/plan.py. A stage does nothing twice: stop it, start it.
"""

from pathlib import Path

from buggy_rl.commands import command_line
from buggy_rl.core.config import from_command_line, run, save_run


def main() -> None:
    """Runs the stages of the config."""
    config = from_command_line(__doc__, "buggy_rl.proof.transfer.plan:TransferConfig")

    from buggy_rl.jobs import results
    from buggy_rl.jobs.bar import run_with_bar, tqdm
    from buggy_rl.proof.transfer.jobs import (
        diagnosis_jobs,
        models,
        record,
        recorded,
        training_jobs,
        write_factories,
    )
    from buggy_rl.proof.transfer.score import drive_policies, unjudged

    if not config.cars:
        raise ValueError("no car: name some, as cars.CAR.EFFECT.PARAMETER=VALUE")
    write_factories(config)

    if "drive" in config.stages:
        left = {n: c for n, c in config.cases.items() if not recorded(c, config.car(n))}
        if left:
            print(f"driving {', '.join(left)}, all at once ...", flush=True)
            record(list(left.values()), [config.car(name) for name in left])
    for stage, listed, unit in (
        ("diagnose", diagnosis_jobs, "car"),
        ("learn", models, "car"),
        ("train", training_jobs, "step"),
    ):
        if stage in config.stages:
            jobs = listed(config, Path(__file__).parent)
            run_with_bar(stage, jobs, unit, config.workers, config)
    if "evaluate" in config.stages:
        left = unjudged(config)
        with tqdm(desc="evaluate", total=sum(len(j.policies) for j in left), unit="policy") as bar:
            calls = {"_".join(j.file.with_suffix("").parts[-3:]): (j,) for j in left}
            place = Path(config.output) / "jobs"
            for count in results(drive_policies, calls, place, config.workers, config):
                bar.update(count)
    save_run(config, Path(config.output))
    if "page" in config.stages:
        write_results(config)


def write_results(config) -> None:
    """Writes the page, its picture and its numbers, and prints the first tables."""
    from buggy_rl.core.files import write_json
    from buggy_rl.proof.transfer.page import transfer_figure, transfer_page
    from buggy_rl.proof.transfer.score import answers, pairs, transfer_results

    folder, drives = Path(config.output), pairs(config)
    write_json(folder / "transfer.json", transfer_results(config, drives))
    transfer_figure(drives).savefig(folder / "transfer.png", dpi=130)
    command = command_line(without="stages=")
    text = transfer_page(config, drives, answers(config), command, "transfer.png")
    (folder / "transfer.md").write_text(text)
    print(text.split("![")[0] + f"written: {folder / 'transfer.md'}")


if __name__ == "__main__":
    run(main)
