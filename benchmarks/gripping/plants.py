"""Simulators that are to slide earlier, and the same cars with that friction inside."""

from collections.abc import Callable

import torch
from tensordict import TensorDict, TensorDictBase
from tests import plain_env
from torchrl.envs import EnvBase

from buggy_rl.proof.plants import make_plant
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.base import Engine
from buggy_rl.simulators.mujoco import MujocoEngine
from buggy_rl.simulators.serial import in_single_precision

FACTORS = {  # declared parameters of less friction at the same stiffness, as exponents of the grip
    "single_track": {
        "front_grip": 1.0,
        "rear_grip": 1.0,
        "front_stiffness": -1.0,
        "rear_stiffness": -1.0,
    },
    "contact": {"grip_front": 1.0, "grip_rear": 1.0},
}
KEEPING = {"reference": -0.15, "mujoco": -0.4, "contact": -0.4, "commonroad": -0.3}
"""Throttle that keeps 2.5 m/s; -0.5 elsewhere, and -0.3 of the plain car."""
HEAVY = {"yaw_inertia": 0.009, "mass": 2.2, "cg_to_front_axle": 0.1}


class Closed(EnvBase):
    """An engine that says nothing of itself: only what the contract asks of a simulator."""

    batch_locked = True  # type: ignore[assignment]  # TorchRL: a property it lets subclasses set

    engine: EnvBase

    def __init__(self, engine: EnvBase) -> None:
        super().__init__(device=engine.device, batch_size=engine.batch_size)
        self.engine = engine
        for specs in ("observation", "state", "action", "reward", "done"):
            setattr(self, f"full_{specs}_spec", getattr(engine, f"full_{specs}_spec").clone())

    def _reset(self, tensordict: TensorDictBase | None = None, **rest) -> TensorDictBase:
        return self.engine._reset(tensordict, **rest)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        return self.engine._step(tensordict)

    def _set_seed(self, seed: int | None) -> None:
        """Nothing is random."""


def _scaled(engine: Engine, powers: dict[str, float], grip: float) -> Engine:
    values = {n: (engine.values[n] * grip**p).expand(engine.batch_size) for n, p in powers.items()}
    return engine.with_parameters(TensorDict(values, engine.batch_size))


def _made(plant: str, cars: int, grip: float) -> EnvBase:
    faults = {} if grip == 1.0 else {"tire_grip": {"grip": grip}}
    if plant == "plain":
        numbers = {"grip": 0.85 * grip, "stiffness": 6.0 / grip}
        return in_single_precision(plain_env.QuickCar(cars, numbers=numbers))  # type: ignore[arg-type]
    if plant == "heavy":
        return Closed(make_plant("reference", cars, faults, HEAVY))
    if plant == "contact":
        return _scaled(MujocoEngine(cars, tyres="contact"), FACTORS[plant], grip)
    if plant == "single_track":
        engine = make_engine(plant, cars)
        assert isinstance(engine, Engine)
        return _scaled(engine, FACTORS[plant], grip)
    return make_plant(plant, cars, faults)


def maker(plant: str, grip: float = 1.0) -> Callable[[int], EnvBase]:
    """Builds a plant, or `plain` and `heavy`, which say nothing of themselves, for n environments.

    `plain` is the simulator of `tests/plain_env.py`, `heavy` a closed reference car of other mass,
    inertia and centre of gravity.
    """
    return lambda cars: _made(plant, cars, grip)


def commands(plant: str, cars: int, rows: int) -> tuple[torch.Tensor, TensorDict]:
    """Commands [rows, cars, 2], from gentle to full lock, and starts at 1 to 3.5 m/s."""
    generator = torch.Generator().manual_seed(5)
    knots = torch.rand(cars, 2, 8, generator=generator) * 2 - 1
    smooth = torch.nn.functional.interpolate(knots, rows, mode="linear", align_corners=True)
    hard = torch.linspace(0.3, 1.6, cars)[torch.randperm(cars, generator=generator)]
    more, steering = (smooth.permute(2, 0, 1) * hard.unsqueeze(-1)).unbind(-1)
    kept = KEEPING.get(plant, -0.3 if plant in ("plain", "heavy") else -0.5)
    velocity = torch.zeros(cars, 3)
    velocity[:, 0] = 1.0 + 2.5 * torch.rand(cars, generator=generator)
    start = TensorDict({"velocity": velocity, "pose": torch.zeros(cars, 3)}, [cars])
    return torch.stack([0.45 * more + kept, steering], -1).clamp(-1, 1), start
