"""Cases in which the tool could not tell, driven once more: the manoeuvres that it asked for."""

import json
import shutil
from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from buggy_rl import keys
from buggy_rl.blind_test.case import Case
from buggy_rl.blind_test.measuring import measured
from buggy_rl.blind_test.motion import Ride, driven
from buggy_rl.blind_test.sealing import Vault
from buggy_rl.diagnosis.experiments import TIMES
from buggy_rl.diagnosis.manoeuvres import MANOEUVRES, Manoeuvre
from buggy_rl.plants import make_plant
from buggy_rl.recordings import save_recording
from buggy_rl.vehicle import CONTROL_PERIOD

FIRST = 200  # number of the first such drive, behind all others' noise


class ManoeuvreDriver:
    """Drives a manoeuvre without looking: as commands over time.

    Args:
        manoeuvre: What to drive.
        dt: Control period [s].
    """

    def __init__(self, manoeuvre: Manoeuvre, dt: float = CONTROL_PERIOD) -> None:
        self.actions = manoeuvre.actions(dt)
        self.row = 0

    def start_pose(self, batch_size: Sequence[int]) -> Tensor:
        """Poses [cars, 3] in the middle, all around the compass."""
        pose = torch.zeros(*batch_size, 3)
        pose[:, 2] = torch.arange(len(pose)) * 2 * torch.pi / len(pose) - torch.pi
        return pose

    def __call__(self, seen: TensorDictBase) -> TensorDictBase:
        """Writes `action` [cars, 2]."""
        seen[keys.ACTION] = self.actions[self.row].expand(*seen.batch_size, 2).clone()
        self.row += 1
        return seen


def asked_for(vault: Vault, case: Case) -> list[Manoeuvre]:
    """The manoeuvres that the tool asked for, where it could not tell."""
    file = vault.said(case.id) / "diagnosis.json"
    if not file.exists():
        return []
    answer = json.loads(file.read_text())
    suggested = answer.get("excitation", {}).get("suggest", [])
    if answer["verdict"] != "cannot_tell":
        return []
    return [m for m in MANOEUVRES if any(line.startswith(m.words) for line in suggested)]


def again(case: Case) -> str:
    """Name of the case's second try."""
    return f"{case.id}_again"


def undecided(vault: Vault, cases: Sequence[Case]) -> list[Case]:
    """Cases whose manoeuvre is still to be driven."""
    return [
        case
        for case in cases
        if not (vault.seen(again(case)) / "question.yaml").exists() and asked_for(vault, case)
    ]


def drive_again(vault: Vault, case: Case) -> int:
    """Drives the manoeuvres in the concealed car and adds the drives to what was seen.

    Returns:
        1, the number of cases.
    """
    manoeuvres = asked_for(vault, case)
    assert manoeuvres
    seen, folder = vault.seen(case.id), vault.seen(again(case))
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(seen, folder, ignore=shutil.ignore_patterns("question.yaml"))
    number = 0
    for manoeuvre in manoeuvres:
        driver = ManoeuvreDriver(manoeuvre)
        plant = make_plant(case.plant, TIMES, case.faults)
        true: TensorDict = driven(plant, [Ride(driver, slice(0, TIMES))], len(driver.actions))
        for place in range(TIMES):
            drive = measured(case, true[place], True, FIRST + number)
            save_recording(drive, folder / "recordings" / f"manoeuvre_{number}.csv")
            number += 1
    # Last: a folder with a question is whole.
    shutil.copyfile(seen / "question.yaml", folder / "question.yaml")
    return 1
