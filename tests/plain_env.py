"""A user's own simulator, written against TorchRL alone: the contract and nothing beyond it.

`make` declares nothing; `make_declared` declares parameters, so that they can be fitted. Float64
throughout, latent state under keys of its own (one of them nested), explicit Euler in a Python
loop. The only thing of this package that it uses is `Parameter`, in `make_declared`.
"""

from collections.abc import Sequence
from typing import ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from buggy_rl.core.parameters import Parameter

PERIOD = 0.01  # [s]
SUBSTEPS = 100  # about ten times slower than this package's engines
FRONT, REAR = 0.082, 0.092  # [m] from the reference point to each axle
MASS, YAW_INERTIA = 1.6, 0.02  # [kg], [kg m^2]
GRAVITY = 9.81  # [m/s^2]
SLOWEST = 0.5  # [m/s] below it slip angles are those at this speed
NUMBERS = {  # drive [N], drag [N s/m], friction [N], grip, tyre stiffness, lock [rad], times [s]
    "motor_force": 12.0,
    "motor_damping": 2.0,
    "rolling_friction": 1.2,
    "grip": 0.85,
    "stiffness": 6.0,
    "full_lock": 0.35,
    "servo_time": 0.08,
    "motor_time": 0.05,
}


class PlainCar(EnvBase):
    """A bicycle with saturating tyres behind a motor and a servo, each of first order.

    m (dvx - vy r) = F - c vx - f tanh(10 vx) - Fy_front sin(delta),
    m (dvy + vx r) = Fy_front cos(delta) + Fy_rear,
    Iz dr = a Fy_front cos(delta) - b Fy_rear,
    Fy = -mu Fz tanh(B alpha),  dF = (F0 (u + 1) / 2 - F) / T_m,  d delta = (D s - delta) / T_s.
    """

    substeps = SUBSTEPS
    batch_locked = True  # type: ignore[assignment]  # TorchRL: a property it lets subclasses set

    def __init__(
        self,
        batch_size: int | Sequence[int],
        device: torch.device | str = "cpu",
        numbers: dict[str, float | Tensor] | None = None,
    ) -> None:
        shape = torch.Size([batch_size] if isinstance(batch_size, int) else batch_size)
        super().__init__(device=torch.device(device), batch_size=shape)
        self.numbers = {**NUMBERS, **(numbers or {})}
        servo = Composite(angle=self._spec(1), shape=shape)
        self.observation_spec = Composite(
            pose=self._spec(3),
            velocity=self._spec(3),
            motor_force=self._spec(1),
            servo=servo,
            shape=shape,
        )
        self.state_spec = self.observation_spec.clone()
        commands = torch.Size([*shape, 2])
        self.action_spec = Bounded(-1.0, 1.0, commands, dtype=torch.float64, device=self.device)
        self.reward_spec = self._spec(1)
        flag = Binary(1, shape=torch.Size([*shape, 1]), dtype=torch.bool, device=self.device)
        self.full_done_spec = Composite(done=flag, terminated=flag.clone(), shape=shape)

    def _spec(self, size: int) -> Unbounded:
        shape = torch.Size([*self.batch_size, size])
        return Unbounded(shape, dtype=torch.float64, device=self.device)

    def _reset(self, tensordict: TensorDictBase | None = None, **_) -> TensorDictBase:
        start = self.observation_spec.zero()
        for key in ("pose", "velocity"):
            if tensordict is not None and tensordict.get(key, None) is not None:
                start[key] = tensordict[key].clone()
        return start

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        throttle, steering = tensordict["action"].clamp(-1.0, 1.0).unbind(-1)
        pose, velocity = tensordict["pose"], tensordict["velocity"]
        force = tensordict["motor_force"].squeeze(-1)
        angle = tensordict["servo", "angle"].squeeze(-1)
        h, n = PERIOD / self.substeps, self.numbers
        for _ in range(self.substeps):
            force = force + h * (n["motor_force"] * (throttle + 1) / 2 - force) / n["motor_time"]
            angle = angle + h * (n["full_lock"] * steering - angle) / n["servo_time"]
            pose = pose + h * self._world(pose, velocity)
            velocity = velocity + h * self._acceleration(velocity, force, angle)
        flag = torch.zeros((*self.batch_size, 1), dtype=torch.bool, device=self.device)
        after = self.observation_spec.zero()
        after["pose"], after["velocity"] = pose, velocity
        after["motor_force"] = force.unsqueeze(-1)
        after["servo", "angle"] = angle.unsqueeze(-1)
        after["reward"] = self.reward_spec.zero()
        after["done"], after["terminated"] = flag, flag.clone()
        return after

    def _world(self, pose: Tensor, velocity: Tensor) -> Tensor:
        vx, vy, yaw_rate = velocity.unbind(-1)
        cos, sin = torch.cos(pose[..., 2]), torch.sin(pose[..., 2])
        return torch.stack([cos * vx - sin * vy, sin * vx + cos * vy, yaw_rate], -1)

    def _acceleration(self, velocity: Tensor, force: Tensor, angle: Tensor) -> Tensor:
        n = self.numbers
        vx, vy, yaw_rate = velocity.unbind(-1)
        speed = vx.abs().clamp_min(SLOWEST)
        front_slip = torch.atan2(vy + FRONT * yaw_rate, speed) - angle
        rear_slip = torch.atan2(vy - REAR * yaw_rate, speed)
        load = MASS * GRAVITY / (FRONT + REAR)
        front = -n["grip"] * load * REAR * torch.tanh(n["stiffness"] * front_slip)
        rear = -n["grip"] * load * FRONT * torch.tanh(n["stiffness"] * rear_slip)
        resistance = n["motor_damping"] * vx + n["rolling_friction"] * torch.tanh(10 * vx)
        ahead, left = front * torch.sin(angle), front * torch.cos(angle)
        return torch.stack(
            [
                (force - resistance - ahead) / MASS + vy * yaw_rate,
                (left + rear) / MASS - vx * yaw_rate,
                (FRONT * left - REAR * rear) / YAW_INERTIA,
            ],
            -1,
        )

    def _set_seed(self, seed: int | None) -> None:
        pass  # nothing is random


class DeclaredCar(PlainCar):
    """The same, which says what can be fitted."""

    declared: ClassVar[dict[str, Parameter]] = {
        "motor_force": Parameter("motor_force", 12.0, 4.0, 30.0, "N", "Force at full throttle."),
        "motor_damping": Parameter("motor_damping", 2.0, 0.2, 6.0, "N s/m", "Drag of the motor."),
        "grip": Parameter("grip", 0.85, 0.3, 1.5, "-", "Friction coefficient of the tyres."),
        "full_lock": Parameter("full_lock", 0.35, 0.2, 0.6, "rad", "Road-wheel angle at full."),
    }

    def with_parameters(self, values: TensorDictBase) -> "DeclaredCar":
        """The same car with `values`, each of the batch's shape."""
        numbers = {name: value.double() for name, value in values.items()}
        return DeclaredCar(values.batch_size, self.device or "cpu", {**self.numbers, **numbers})


def make(batch_size: int | Sequence[int], device: torch.device | str = "cpu") -> EnvBase:
    """A simulator that declares nothing."""
    return PlainCar(batch_size, device)


def make_declared(batch_size: int | Sequence[int], device: torch.device | str = "cpu") -> EnvBase:
    """The same simulator with four declared parameters."""
    return DeclaredCar(batch_size, device)


class QuickCar(PlainCar):
    """The same in larger steps, for tests that roll it out many times."""

    substeps = 4


def make_quick(batch_size: int | Sequence[int], device: torch.device | str = "cpu") -> EnvBase:
    """A simulator that declares nothing, less finely integrated."""
    return QuickCar(batch_size, device)
