"""Scenes for the faults of the reference car: cars alike but for a fault, all driven at once."""

import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.simulators.reference import ReferenceEngine
from buggy_rl.simulators.reference.faults import NEUTRAL
from tests.simulators.reference_drives import SYMMETRIC, drive, start

# Of the car with its turning wheels over the car: 4 wheels of 2.8e-5 / 0.0325^2 = 26.5 g and a
# rotor of 2e-6 (6.7 / 0.0325)^2 = 85 g at the tread on 1.625 kg.
TURNING = (1.625 + 4 * 0.02651 + 0.0850) / 1.625  # 1.1176


class Scenes:
    """Drives by their title; a step of a hundred cars costs little more than a step of one."""

    def __init__(self):
        self.planned = {}  # title -> faults of each car [n], velocity and pose [n, 3], [T, n, 2]

    def add(self, title, name, values, first, actions, heading=0.0, **more):
        """Has cars that differ in one fault, `more` alike, drive off with `first` velocity."""
        count = len(values)
        pose = torch.zeros(count, 3)
        pose[:, 2] = torch.as_tensor(heading)
        actions = actions if actions.dim() == 3 else actions.unsqueeze(1).expand(-1, count, 2)
        faults = {name: list(values)} | {other: [value] * count for other, value in more.items()}
        self.planned[title] = (faults, torch.tensor(first).expand(count, 3), pose, actions)

    def driven(self):
        """A function from a title to states [T + 1, n]."""
        count = sum(len(first) for _, first, *_ in self.planned.values())
        longest = max(len(actions) for *_, actions in self.planned.values())
        names = {name for faults, *_ in self.planned.values() for name in faults}
        faults = {name: torch.full((count,), NEUTRAL[name]) for name in names}
        rows, begin, commands = {}, 0, []
        for title, (own, first, _, actions) in self.planned.items():
            rows[title] = slice(begin, begin + len(first)), len(actions)
            for name, values in own.items():
                faults[name][rows[title][0]] = torch.tensor(values)
            commands.append(
                torch.cat([actions, actions[-1:].expand(longest - len(actions), -1, 2)])
            )
            begin += len(first)
        engine = ReferenceEngine(parameters=SYMMETRIC).with_faults(TensorDict(faults, [count]))
        _, first, pose, _ = zip(*self.planned.values(), strict=True)
        state = start(torch.cat(first), torch.cat(pose))
        states = drive(engine, state, torch.cat(commands, 1))
        return lambda title: states[: rows[title][1] + 1, rows[title][0]]


def cars(name, *values, **more):
    """One car for each value of a fault, else alike and symmetric."""
    faults = TensorDict({name: torch.tensor(values)}, [len(values)])
    for other, value in more.items():
        faults[other] = torch.full((len(values),), value)
    return ReferenceEngine(parameters=SYMMETRIC).with_faults(faults)


def velocities(states):
    """vx, vy and yaw rate, each [T + 1, n]."""
    return states[keys.VELOCITY].unbind(-1)


def crossing(signal, level):
    """When [s] each signal [T, n] first passes a level, straight between rows."""
    times = []
    for row in signal.T.tolist():
        k = next(i for i, value in enumerate(row) if value > level)
        times.append(0.01 * (k - 1 + (level - row[k - 1]) / (row[k] - row[k - 1])))
    return times
