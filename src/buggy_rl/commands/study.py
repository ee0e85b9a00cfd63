"""A whole study by one command: from a folder of recordings to study.html.

    python scripts/study.py configs/study.yaml data.recordings=my/folder output=runs/my_study
    python scripts/study.py configs/sample.yaml configs/study.yaml output=runs/sample_study
    python scripts/study.py configs/dart.yaml

Trains models, fits the simulator, compares them on held-out recordings, trains a policy in each of
two, drives them everywhere, diagnoses a simulator (the one as it comes on the training recordings,
or the fitted one on the held-out ones: diagnosed=), judges the repaired one, draws the figures and
writes OUTPUT/study.html. Each stage is a script that could be run by hand; its log lies in
OUTPUT/stages/NAME. Started again, it does not run again what is there.
"""

from pathlib import Path

from buggy_rl.commands import command_line
from buggy_rl.core.config import from_command_line, made_by, run, save_run


def main() -> None:
    """Runs the stages, then writes the page."""
    config = from_command_line(__doc__, "buggy_rl.visual.study.stages:WholeStudyConfig")

    from datetime import date

    from buggy_rl.core.files import write_atomically
    from buggy_rl.core.question import contents
    from buggy_rl.estimation.fit_study import load_drives
    from buggy_rl.jobs.bar import tqdm
    from buggy_rl.visual.study.page import Made, study_page
    from buggy_rl.visual.study.stages import StudyPlan

    folder = Path(config.output)
    drives = load_drives(config.data, tqdm.write, config.car)
    compared = drives.held_out if config.diagnosed == "fitted" else drives.training
    read = (
        contents(drives.training)
        | contents(drives.validation, "validation recording")
        | contents(drives.held_out, "held-out recording")
    )
    plan = StudyPlan(config, [r.source for r in compared], Path(__file__).parent, read)
    stages = []
    for number, wave in enumerate(plan.waves()):
        if number == 0:
            for stage in wave:
                _ = stage.job.done  # refused before anything is written
            plan.write()
        stages += wave
        follow(wave, config)
    made = Made(command_line(), made_by()["commit"], date.today().isoformat())
    save_run(config, folder)
    write_atomically(folder / "study.html", study_page(plan, drives, stages, made))
    print(f"written: {folder / 'study.html'}")


def follow(wave, config) -> None:
    """Runs the stages of a wave, with a line for each that has ended."""
    from buggy_rl.jobs import run_jobs
    from buggy_rl.jobs.bar import tqdm

    waiting = {stage.job.name: stage.title for stage in wave if not stage.job.done}
    with tqdm(bar_format="{elapsed} {desc}") as bar:
        bar.set_description_str(" | ".join(waiting.values()))
        for progress in run_jobs([stage.job for stage in wave], config.workers, config, 1.0):
            bar.refresh()
            if progress.outcome is not None:
                title = waiting.pop(progress.job.name)
                tqdm.write(f"{title}: {progress.outcome.status}, {progress.outcome.seconds:.0f} s")
                bar.set_description_str(" | ".join(waiting.values()))


if __name__ == "__main__":
    run(main)
