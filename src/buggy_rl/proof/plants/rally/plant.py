"""The rally car as an engine whose whole state rides in the TensorDict.

`pose` and `velocity` are those of the tracking sensor, which sits on the car's centre of gravity; a
payload stands over it, so that it stays there. Wheel speeds ride as slip against the road, so that
an edit of the velocity takes the wheels along. An unknown effect of the sensor leaves `pose` and
`velocity` true: what is shown is in `measured_pose` and `measured_velocity`, which other cars do
not have.

Faults are the effects of `textbook`, and the author's unknown effects, `{kind: {"size": value}}`.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from buggy_rl.core import keys
from buggy_rl.proof.plants.faults import PlantFaults
from buggy_rl.proof.plants.rally.arrays import Array, Arrays, col, sum4
from buggy_rl.proof.plants.rally.body import contact_velocity
from buggy_rl.proof.plants.rally.car import RallyCar
from buggy_rl.proof.plants.rally.changes import constants
from buggy_rl.proof.plants.rally.declared import PARAMETERS, as_author
from buggy_rl.proof.plants.rally.steering import PERIOD, wheel_angles
from buggy_rl.proof.plants.rally.textbook import EFFECTS, changes_of
from buggy_rl.proof.plants.rally.unknown_sensor import SENSOR
from buggy_rl.proof.plants.rally.unknowns import UNKNOWNS
from buggy_rl.simulators.base import FLOAT, RowsEngine

ABILITIES = EFFECTS | frozenset(UNKNOWNS)
STATE = "rally_state"  # [M] all but pose and velocity, in the order of `RallyPlant._layout`
MOTION = ("x", "y", "yaw", "vx", "vy", "yaw_rate")
SHOWN = (keys.MEASURED_POSE, keys.MEASURED_VELOCITY)
DERIVED = (*MOTION, "rotor")  # of the author's state: the rotor turns with the driven wheels
SUBSTEPS = 10  # of a control period, as the author has it
SENSOR_KINDS = frozenset(kind.name for kind in SENSOR)


def make_rally(
    cars: int, faults: Mapping[str, Mapping[str, float]], parameters: Mapping[str, float] | None
) -> "RallyPlant":
    """Rally cars with faults; without parameters they are in the middle of all ranges."""
    return RallyPlant(cars, parameters=parameters, faults=faults)


class RallyPlant(RowsEngine):
    """Rally cars in one batch of arrays, on the CPU whatever the device.

    Args:
        *args: As for `Engine`.
        faults: `{effect: {parameter: value}}`, of `ABILITIES`.
        substeps: Steps in a control period.
        **common: As for `Engine`.

    Raises:
        KeyError: There is no such parameter, effect or effect's parameter.
        ValueError: A value is outside its range.
    """

    def __init__(
        self,
        *args: Any,
        faults: Mapping[str, Mapping[str, float]] | None = None,
        substeps: int = SUBSTEPS,
        **common: Any,
    ) -> None:
        super().__init__(*args, declared=PARAMETERS, **common)
        if self.dt != PERIOD:
            raise ValueError(f"dt is {self.dt} s: the rally car's control period is {PERIOD} s")
        given = faults or {}
        textbook = {e: values for e, values in given.items() if e not in UNKNOWNS}
        self._faults = PlantFaults(textbook, ABILITIES, "rally")
        self._unknown = {e: _size(e, values) for e, values in given.items() if e in UNKNOWNS}
        self._misled = bool(SENSOR_KINDS & set(self._unknown))
        self.substeps = substeps
        self._parameters_changed()
        self._finish()

    def _parameters_changed(self) -> None:
        count = max(self.numel(), 1)
        own = {
            name: np.broadcast_to(value.reshape(-1).double().cpu().numpy(), (count,))
            for name, value in self.values.items()
        }
        numbers = as_author(own)
        changes = changes_of(self._faults, constants(numbers, {}))
        self._car = RallyCar(numbers, changes, self._unknown, self.substeps)
        still = self._car.start(np.zeros(3), np.zeros(3))
        self._layout = {n: v.shape[1:] for n, v in still.items() if n not in DERIVED}

    def _latent_specs(self) -> dict[str, TensorSpec]:
        size = sum(math.prod(shape) for shape in self._layout.values())
        shown = self._number_specs(dict.fromkeys(SHOWN, (3,)), FLOAT) if self._misled else {}
        return self._number_specs({STATE: (size,)}, torch.float64) | shown

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        return self._packed(self._car.start(self._rows(pose), self._rows(velocity)))

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        moved = self._car.step(self._unpacked(state), self._rows(action))
        return {
            keys.POSE: self._tensor(self._car.pose(moved)).to(FLOAT),
            keys.VELOCITY: self._tensor(self._car.velocity(moved)).to(FLOAT),
            **self._packed(moved),
        }

    def _packed(self, state: Arrays) -> dict[str, Tensor]:
        """Latent state of an author's state."""
        state = state | {"wheel": state["wheel"] - self._rolling(state)}
        rows = np.concatenate([state[n].reshape(self._car.cars, -1) for n in self._layout], 1)
        latent = {STATE: self._tensor(rows)}
        if self._misled:
            shown = self._car.shown(state)
            values = (shown["pose"], shown["velocity"])
            latent |= {key: self._tensor(v).to(FLOAT) for key, v in zip(SHOWN, values, strict=True)}
        return latent

    def _unpacked(self, state: TensorDictBase) -> Arrays:
        """The author's state of what the TensorDict has."""
        motion = np.concatenate([self._rows(state[k]) for k in (keys.POSE, keys.VELOCITY)], 1)
        rows, first = self._rows(state[STATE]), 0
        found: Arrays = {name: motion[:, column].copy() for column, name in enumerate(MOTION)}
        for name, shape in self._layout.items():
            last = first + math.prod(shape)
            found[name] = rows[:, first:last].reshape(-1, *shape)
            first = last
        found["wheel"] = found["wheel"] + self._rolling(found)
        geared = sum4(self._car.constants["gear_share"] * found["wheel"])
        return found | {"rotor": geared + found["clutch_slip"]}

    def _rolling(self, state: Arrays) -> Array:
        """Speeds [n, 4] [rad/s] of wheels that roll as the car moves."""
        k = self._car.constants
        angle = wheel_angles(k, state["rack"], np.zeros((self._car.cars, 4)))
        return contact_velocity(k, state, angle)[0] / col(k["radius"])

    def _options(self) -> dict[str, Any]:
        sizes = {kind: {"size": size} for kind, size in self._unknown.items()}
        return {"faults": self._faults.given | sizes, "substeps": self.substeps}


def _size(kind: str, values: Mapping[str, float]) -> float:
    if set(values) != {"size"}:
        raise KeyError(f"unknown effect {kind} has the parameter size alone, not {sorted(values)}")
    size, most = float(values["size"]), UNKNOWNS[kind][1]
    if not 0.0 <= size <= most:
        raise ValueError(f"fault {kind}.size is {size:g}: must be in [0, {most:g}]")
    return size
