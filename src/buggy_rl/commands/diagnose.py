"""Says where a simulator and drives differ, what physics is missing, and gives back the simulator.

    python scripts/diagnose.py simulator=fitted.yaml recordings=drives/ output=runs/diagnosis
    python scripts/diagnose.py simulator=my.py:make recordings=new/ baseline=old/ output=runs/d

Writes OUTPUT/diagnosis.json, repaired.yaml (which every script takes as a simulator), report.html.
Interrupted, it goes on where it stopped when it is started again. With `cars=FOLDER` in place of
recordings, every folder in it is one car's recordings: each is diagnosed by itself in OUTPUT/CAR,
`workers` at a time on any `launcher` (docs/scale.md), and OUTPUT/fleet.csv has a row for each.
"""

from pathlib import Path

from buggy_rl.config import from_command_line, run, save_run


def main() -> None:
    """Diagnoses and writes."""
    config = from_command_line(__doc__, "buggy_rl.diagnosis.fleet:FleetConfig")
    if config.cars:
        return each_car(config)
    config = config.single

    import json

    import torch
    import yaml

    from buggy_rl.diagnosis.pipeline import diagnose
    from buggy_rl.diagnosis.repair import repaired
    from buggy_rl.diagnosis.report import report, sheet_of
    from buggy_rl.diagnosis.stages import FOLDER as STAGES
    from buggy_rl.diagnosis.stages import asked, begun_otherwise, clear
    from buggy_rl.diagnosis.step_bar import StepBar
    from buggy_rl.estimation.baseline import FILE
    from buggy_rl.files import write_atomically
    from buggy_rl.jobs.bar import tqdm

    torch.set_num_threads(1)
    recordings = loaded(config, config.recordings, "drive")
    baseline = loaded(config, config.baseline, "baseline drive") if config.baseline else []
    folder = Path(config.output)
    if why := begun_otherwise(folder / STAGES, asked(config, recordings, baseline)):
        tqdm.write(f"note: begun anew, not gone on with what is in {folder / STAGES}: {why}")
    with StepBar() as bar:
        done = diagnose(config, recordings, bar.says, baseline, folder / STAGES, bar.show)
        answer = done.answer
        bar.says("drawing the report")
        content = repaired(config.simulator, done, folder)
        page = report(done.case, done.found, answer, sheet_of(config, content))
    for note in answer.notes:
        tqdm.write(f"note: {note}")
    # Until here the folder may hold the answer to another question, with its config: now, at once.
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / "diagnosis.json", json.dumps(answer.to_dict(), indent=2) + "\n")
    if done.correction is not None and done.correction.effect is not None:
        done.correction.effect.network.save(folder / FILE)
    write_atomically(folder / "repaired.yaml", yaml.safe_dump(content, sort_keys=False))
    write_atomically(folder / "report.html", page)
    save_run(config, folder)
    clear(folder / STAGES)  # the answer is written: nothing is left to go on with
    print("\n".join(answer.lines()))
    names = ("report.html", "diagnosis.json", "repaired.yaml")
    print(f"written: {', '.join(str(folder / name) for name in names)}")


def loaded(config, names, what: str) -> list:
    """Recordings that can be used; says which cannot."""
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.recordings import load_recordings
    from buggy_rl.recordings.notes import doubtful

    found, refusals = load_recordings(names, config.columns or None, config.dt, iter, config.car)
    for refusal in refusals:
        tqdm.write(f"refused: {refusal}")
    for recording in found:
        for note in doubtful(recording.notes):
            tqdm.write(f"{recording.name}: {note}")
    if not found:
        raise ValueError(f"no {what} is left to look at: the lines above say why")
    return found


def each_car(config) -> None:
    """Diagnoses every car of a folder and writes one table."""
    import pandas as pd

    from buggy_rl.diagnosis.fleet import diagnoses, rows
    from buggy_rl.jobs import cores
    from buggy_rl.jobs.bar import run_with_bar

    jobs, file = diagnoses(config, Path(__file__)), Path(config.output) / "fleet.csv"
    try:
        run_with_bar("diagnosing", jobs, "car", config.workers or cores(), config)
    finally:
        table = pd.DataFrame(rows(jobs))
        table.to_csv(file, index=False)
        print(f"{table.to_string(index=False)}\nwritten: {file}")


if __name__ == "__main__":
    run(main)
