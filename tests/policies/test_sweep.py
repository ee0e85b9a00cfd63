"""The search for settings: what is proposed, when a trial is pruned, and that it can be stopped."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from buggy_rl.core.config import build
from buggy_rl.figures.policies import sweep_figure
from buggy_rl.jobs.job import Job
from buggy_rl.policies.training.sweep import (
    VALIDATED,
    Ended,
    OptionRange,
    Sweep,
    SweepConfig,
    curve,
)

ROOT = Path(__file__).parents[2]
SPACE = {
    "ppo.learning_rate": OptionRange(1e-4, 1e-2, log=True),
    "ppo.epochs": OptionRange(2, 5, integer=True),
}
SMALL = (
    "steps=2048", "trials=4", "together=2", "startup=1", "best=1",
    "seeds=[1,2]", "validations=2",
    "policy=[configs/ppo.yaml,engine.simulator=kinematic,ppo.cars=32,ppo.batch_steps=16,"
    "ppo.minibatch=256,validation_steps=30]",
)  # fmt: skip


def config(folder: Path, **more) -> SweepConfig:
    return SweepConfig(output=str(folder), space=SPACE, **more)


def write_curve(folder: Path, values: list[float]) -> None:
    file = folder / VALIDATED
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text("".join(f"{100 * n},{value}\n" for n, value in enumerate(values, 1)))


def test_the_shipped_space_is_read_and_names_options_of_a_training():
    shipped = build(SweepConfig, [str(ROOT / "configs" / "sweep.yaml")])
    assert shipped.space["ppo.learning_rate"].log
    assert shipped.space["ppo.epochs"].integer
    assert shipped.space["ppo.minibatch"].choices == [1024, 2048, 4096]


@pytest.mark.parametrize(
    ("more", "message"),
    [({"space": {}}, "space is empty"), ({"seeds": [0, 1]}, "seed=0 is among seeds")],
)
def test_a_sweep_of_nothing_or_confirmed_by_its_own_seed_is_refused(more, message):
    with pytest.raises(ValueError, match=message):
        SweepConfig(**{"output": "out", "space": SPACE, **more})


@pytest.mark.parametrize("space", [OptionRange(2.0, 1.0), OptionRange(0.0, 1.0, log=True)])
def test_an_empty_range_is_named(space):
    with pytest.raises(ValueError, match=r"space.ppo.clip: low=.*must be below high"):
        space.suggested(None, "ppo.clip")


def test_proposals_do_not_depend_on_where_a_round_was_interrupted(tmp_path):
    whole = Sweep(config(tmp_path / "whole", together=4), Path("train_policy.py"))
    wanted = [trial.params for trial in whole._asked(0)]
    halves = Sweep(config(tmp_path / "halves", together=4, trials=2), Path("train_policy.py"))
    assert [trial.params for trial in halves._asked(0)] == wanted[:2]
    again = Sweep(config(tmp_path / "halves", together=4), Path("train_policy.py"))
    assert [trial.params for trial in again._asked(0)] == wanted
    assert len({json.dumps(each) for each in wanted}) == 4


def test_a_trial_below_the_median_of_complete_ones_is_pruned_at_that_validation(tmp_path):
    sweep = Sweep(config(tmp_path, together=3, startup=3, validations=3), Path("train_policy.py"))
    for trial, values in zip(sweep._asked(0), ([1, 4, 9], [2, 5, 8], [3, 6, 7]), strict=True):
        for step, value in enumerate(values):
            trial.report(value, step)
        sweep.study.tell(trial, max(values))
    # Medians after each validation: 2, 5, 8.
    assert sweep._kept([1.9]) == 1
    assert sweep._kept([2.1, 4.9]) == 2
    assert sweep._kept([2.1, 5.1]) == 0
    assert sweep._kept([2.1, 4.9, 100.0]) == 2  # whatever came while nobody looked
    assert sweep._kept([2.1, 5.1, 0.0]) == 0  # after the last one there is nothing to save
    assert [trial.curve for trial in sweep.ended()] == [[1, 4, 9], [2, 5, 8], [3, 6, 7]]


def test_a_validation_that_was_logged_twice_counts_once(tmp_path):
    assert curve(tmp_path) == []
    write_curve(tmp_path, [3.0, 5.0])
    with open(tmp_path / VALIDATED, "a") as file:
        file.write("200,5.0\n300,7.0\n")
    assert curve(tmp_path) == [3.0, 5.0, 7.0]


def test_a_journal_of_other_settings_is_refused(tmp_path):
    Sweep(config(tmp_path), Path("train_policy.py"))
    Sweep(config(tmp_path, trials=99, workers=7), Path("train_policy.py"))  # more is no other
    with pytest.raises(ValueError, match="begun with other settings"):
        Sweep(config(tmp_path, steps=5), Path("train_policy.py"))


def test_the_best_settings_are_confirmed_by_trainings_of_their_own_length(tmp_path):
    def confirmed(**more) -> list[Job]:
        sweep = Sweep(config(tmp_path, best=1, seeds=[1], **more), Path("train_policy.py"))
        if not sweep.ended():
            [trial] = sweep._asked(0)[:1]
            trial.report(3.0, 0)
            sweep.study.tell(trial, 3.0)
        return [job for jobs in sweep.confirmations().values() for job in jobs]

    short, whole = confirmed(steps=500), confirmed(steps=500, confirm_steps=2000)
    assert [job.work for job in (*short, *whole)] == [500, 500, 2000, 2000]
    assert all("ppo.steps=2000" in job.command for job in whole)
    assert not {job.folder for job in short} & {job.folder for job in whole}


def test_a_missing_optuna_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(ValueError, match=r"a sweep needs the package optuna.*scale"):
        Sweep(config(tmp_path), Path("train_policy.py"))


def test_the_picture_shows_every_setting_with_its_seeds():
    trials = [
        Ended(0, {}, [1.0, 3.0], "complete"),
        Ended(1, {}, [0.5], "pruned"),
        Ended(2, {}, [], "failed"),
    ]
    picture = sweep_figure(trials, {"default": [2.0, 3.0], "trial_0000": [3.0, 4.0]})
    search, seeds = picture.axes
    assert [list(line.get_ydata()) for line in search.lines] == [[3.0], [0.5]]
    assert [label.get_text() for label in seeds.get_xticklabels()] == ["default", "trial_0000"]


YAML = """
space:
  ppo.learning_rate: {low: 1.0e-4, high: 1.0e-2, log: true}
  ppo.clip: {low: 0.1, high: 0.4}
"""


def command_of_sweep(folder: Path, *more: str) -> list[str]:
    file = folder.with_suffix(".yaml")
    file.write_text(YAML)
    return [sys.executable, "scripts/sweep.py", str(file), *SMALL, f"output={folder}", *more]


def swept(folder: Path, *more: str) -> dict[str, bytes]:
    command = command_of_sweep(folder, *more)
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (folder / "sweep.png").stat().st_size > 1000
    return {name: (folder / name).read_bytes() for name in ("trials.csv", "sweep.csv")}


@pytest.mark.slow
def test_a_sweep_that_is_killed_goes_on_to_the_same_result_with_other_workers(tmp_path):
    wanted = swept(tmp_path / "whole", "workers=1")
    folder = tmp_path / "killed"
    command = command_of_sweep(folder, "workers=2")
    for stage in ("trials/0000/checkpoint.pt", "trials/0003/checkpoint.pt"):
        sweep = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL)
        while not (folder / stage).exists() and sweep.poll() is None:
            time.sleep(0.05)
        os.kill(sweep.pid, signal.SIGKILL)
        sweep.wait()
    assert swept(folder, "workers=2") == wanted
