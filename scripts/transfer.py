"""Trains policies for cars in which something is concealed, and drives them there.

    python scripts/transfer.py configs/transfer.yaml
    python scripts/transfer.py configs/transfer.yaml stages=[evaluate,page]
    python scripts/transfer.py configs/transfer.yaml output=runs/quick steps=1000000 seeds=[0]

Four policies for each car, by one budget of PPO: in MuJoCo as fitted before the change, in MuJoCo
repaired by the diagnosis of two minutes of driving, in a model learned from the same two minutes,
and in MuJoCo with randomised physics. Stages: drive (the two minutes), diagnose, learn, train,
evaluate, page. Writes OUTPUT/transfer.md, transfer.json, transfer.png; how OUTPUT is laid out
stands in src/buggy_rl/transfer/plan.py. What is done is not done again: stop it, start it.
"""

import sys
from pathlib import Path

from buggy_rl.config import from_command_line, run, save_run


def main() -> None:
    """Runs the stages that are asked for."""
    config = from_command_line(__doc__, "buggy_rl.transfer.plan:TransferConfig")

    from tqdm import tqdm

    from buggy_rl.blind_test.exam import write_json
    from buggy_rl.blind_test.proof import side_by_side
    from buggy_rl.transfer.evaluation import judge, unjudged
    from buggy_rl.transfer.factory import write_factories
    from buggy_rl.transfer.job import Job
    from buggy_rl.transfer.jobs import diagnoses, models, trainings
    from buggy_rl.transfer.page import page
    from buggy_rl.transfer.pictures import transfer_figure
    from buggy_rl.transfer.recordings import record, recorded
    from buggy_rl.transfer.score import answers, pairs, results
    from buggy_rl.transfer.workshop import worked

    folder, scripts = Path(config.output), Path(__file__).parent
    if not config.cars:
        raise ValueError("no car: name some, as cars.CAR.EFFECT.PARAMETER=VALUE")
    save_run(config, folder)
    write_factories(config)

    def work(what: str, jobs: list[Job], unit: str) -> None:
        come = {job.name: job.work * job.done for job in jobs}
        total = sum(job.work for job in jobs)
        bar = tqdm(
            desc=what, total=total, initial=sum(come.values()), unit=unit, unit_scale=total > 1e4
        )
        with bar:
            for job, share in worked(jobs, config.workers):
                bar.set_postfix_str(job.name)
                reached = max(int(job.work * share), come[job.name])
                bar.update(reached - come[job.name])
                come[job.name] = reached

    if "drive" in config.stages:
        left = {n: c for n, c in config.cases.items() if not recorded(c, config.car(n))}
        if left:
            print(f"driving {', '.join(left)}, all at once ...", flush=True)
            record(list(left.values()), [config.car(name) for name in left])
    if "diagnose" in config.stages:
        work("diagnosing", diagnoses(config, scripts), "car")
    if "learn" in config.stages:
        work("learning", models(config, scripts), "car")
    if "train" in config.stages:
        work("training", trainings(config, scripts), "step")
    if "evaluate" in config.stages:
        left = unjudged(config)
        with tqdm(desc="driving", total=sum(len(j.policies) for j in left), unit="policy") as bar:
            for count in side_by_side(judge, [(j,) for j in left], config.workers):
                bar.update(count)
    if "page" in config.stages:
        drives = pairs(config)
        write_json(folder / "transfer.json", results(config, drives))
        transfer_figure(drives).savefig(folder / "transfer.png", dpi=130)
        command = " ".join(["python", *(a for a in sys.argv if not a.startswith("stages="))])
        text = page(config, drives, answers(config), command, "transfer.png")
        (folder / "transfer.md").write_text(text)
        print(text.split("![")[0] + f"written: {folder / 'transfer.md'}")


if __name__ == "__main__":
    run(main)
