"""Cases that the diagnosis could not decide, with the manoeuvres that it suggested driven."""

import json
import shutil

import torch

from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.drives import acting, driven, plant_of, plant_parameters
from buggy_rl.blind_test.recorded import save_drives
from buggy_rl.blind_test.sealing import INPUTS, CaseStore
from buggy_rl.diagnosis.manoeuvre_drives import TIMES
from buggy_rl.diagnosis.manoeuvres import MANOEUVRES, Manoeuvre
from buggy_rl.files import clear_folder
from buggy_rl.policies.controllers.replay import Replay
from buggy_rl.vehicle import CONTROL_PERIOD

NOISE = 200  # number of the first manoeuvre drive, behind those of all other drives


def suggested(store: CaseStore, case: Case) -> list[Manoeuvre]:
    """The manoeuvres that the diagnosis suggested where its verdict is `cannot_tell`."""
    file = store.diagnosis(case.id) / "diagnosis.json"
    if not file.exists():
        return []
    answer = json.loads(file.read_text())
    if answer["verdict"] != "cannot_tell":
        return []
    lines = answer.get("excitation", {}).get("suggest", [])
    return [m for m in MANOEUVRES if any(line.startswith(m.words) for line in lines)]


def again(case: Case) -> str:
    """Name of the case's second run."""
    return f"{case.id}_again"


def driven_again(store: CaseStore, case: Case) -> bool:
    """Whether the manoeuvres of a case have been driven."""
    return (store.inputs(again(case)) / "question.yaml").exists()


def drive_again(store: CaseStore, case: Case) -> int:
    """Drives the suggested manoeuvres in the concealed car and adds them to the recordings.

    Returns 1, the number of cases.
    """
    inputs, folder = store.inputs(case.id), store.inputs(again(case))
    clear_folder(folder, INPUTS)
    shutil.copytree(inputs, folder, ignore=shutil.ignore_patterns("question.yaml"))
    pose = torch.zeros(TIMES, 3)  # in the middle, headings spread around the compass
    pose[:, 2] = torch.arange(TIMES) * 2 * torch.pi / TIMES - torch.pi
    for place, manoeuvre in enumerate(suggested(store, case)):
        actions = manoeuvre.actions(case.every * CONTROL_PERIOD)
        plant = plant_of(case, TIMES, case.faults, plant_parameters(case))
        act = acting([case.disturbances], [TIMES])
        rows = case.every * len(actions)
        true = driven(plant, Replay(actions), pose, rows, act, case.every)
        numbers = range(place * TIMES, (place + 1) * TIMES)
        named = {f"manoeuvre_{number}": NOISE + number for number in numbers}
        save_drives(case, true, folder / "recordings", named)
    # Last: a folder with a question is complete.
    shutil.copyfile(inputs / "question.yaml", folder / "question.yaml")
    return 1
