"""A supply that fails under load: servo and motor share a battery, and what works gets warm."""

import math
from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import drive_of
from buggy_rl.effects.actuation.command import GIVEN, RememberingCommand
from buggy_rl.effects.actuation.throttle import DriveGainEffect
from buggy_rl.effects.base import EffectParameter, numbers_spec

FASTEST = 5.0  # [1/s] speed at which a servo draws all it draws: half of a standard one's 10
SERVO = 0.06  # [s] time constant of a servo whose simulator shows none; DART's is 0.13, chosen
SHORTEST = 0.5  # [s] least time constant of a heat, for a fit that leaves the bounds


class BrownOut(DriveGainEffect, RememberingCommand):
    """The drive fails while the steering servo draws current: both hang on one battery or BEC.

    d' - onset = (1 - moving min(|ds/dt| / 5 1/s, 1) - holding |s|) (d - onset), with s the servo,
    which follows the steering command with the lag of the simulator's.
    """

    name = "brown_out"
    look_at = "Give the servo a supply (BEC) of its own; check battery, plug and wires."
    equation = (
        "drive' - onset = (1 - moving min(|ds/dt| / 5, 1) - holding |s|) (drive - onset), s the "
        "servo"
    )
    source = (
        "Horowitz & Hill 2015, The Art of Electronics, 3rd ed., sec. 1.2 (source with an internal "
        "resistance), of a supply that servo and motor share"
    )
    declared = (
        EffectParameter(
            "moving",
            0.0,
            0.0,
            1.0,
            "-",
            "Share of the drive that is lost while the servo moves fast.",
            size=0.3,
            probe=0.05,
            usual=(0.0, 0.5),
        ),
        EffectParameter(
            "holding",
            0.0,
            0.0,
            1.0,
            "-",
            "Share that is lost while it holds full lock.",
            size=0.2,
            probe=0.05,
            usual=(0.0, 0.3),
        ),
    )
    option_names = ("onset", "lag")
    lag: float = 0.0
    """Time constant of the simulator's servo [s]; 0 where it shows none."""

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        moving, holding = (100 * values[name] for name in ("moving", "holding"))
        return (
            f"the motor loses {moving:.3g} % of its drive while the steering servo moves and "
            f"{holding:.3g} % while it holds full lock: their supply gives way"
        )

    @property
    def resting(self) -> float:
        return 0.0  # the servo is straight

    def _next(self, command: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """The command [n] as it is, and the servo [n, 1] behind it a period later."""
        follows = -math.expm1(-self.dt / (self.lag or SERVO))
        return command, state + follows * (command.unsqueeze(-1) - state)

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        steering = self._gather(tensordict.get(keys.ACTION)[..., 1], 0).clamp(-1.0, 1.0)
        RememberingCommand._acting(self, steering, tensordict)  # moves the servo on
        return DriveGainEffect._acting(self, command, tensordict)

    def _gain_change(self, tensordict: TensorDictBase) -> Tensor:
        servo, unknown = self._gather(tensordict.get(self.memory)).unbind(-1)
        moved = self._gather(tensordict.get(self.memory + GIVEN))[..., 0]
        speed = torch.where(unknown > 0.5, 0.0, (moved - servo).abs() / self.dt)
        moving = self._value("moving") * (speed / FASTEST).clamp_max(1.0)
        return -(moving + self._value("holding") * moved.abs()).clamp_max(1.0)


class ThermalFoldback(DriveGainEffect):
    """The drive weakens as motor or speed controller get warm, and recovers as they cool.

    dh/dt = (d^2 - h) / T, with h = 1 the heat of full drive for ever: losses go with the square of
    the current, which is taken to go with the drive. A recording begins cool; `warmed` has what
    was driven before a rollout.
    """

    name = "thermal_foldback"
    look_at = "Feel the motor and controller after a run; read the controller's temperature limit."
    equation = (
        "drive' - onset = (1 - foldback h) (drive - onset), time_constant dh/dt = drive^2 - h"
    )
    source = (
        "Hughes & Drury 2019, Electric Motors and Drives, 5th ed., ch. 3 (I^2 R losses and thermal "
        "time constant); controllers limit the current by temperature, as the VESC firmware does"
    )
    deciding = ("foldback",)
    declared = (
        EffectParameter(
            "foldback",
            0.0,
            0.0,
            1.0,
            "-",
            "Share of the drive that is lost at the heat of full drive.",
            size=0.4,
            probe=0.1,
            usual=(0.0, 0.6),
        ),
        EffectParameter(
            "time_constant",
            20.0,
            2.0,
            200.0,
            "s",
            "Time to 63 % of a heat.",
            size=10.0,
            probe=3.0,
            usual=(10.0, 120.0),
        ),
    )

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        lost, after = 100 * values["foldback"], values["time_constant"]
        return (
            f"the drive gets weaker as motor or controller heat up: {lost:.3g} % less at steady "
            f"full throttle, 63 % of that after {after:.3g} s"
        )

    def warmed(self, memory: Tensor, worked: Tensor, edges: tuple[float, ...]) -> Tensor:
        """Memory [*, 1] after what was driven before.

        Args:
            memory: To be replaced.
            worked: [*, B] mean square drive in B intervals of the past.
            edges: [B + 1] of these intervals, in seconds back from now, from 0 on.
        """
        time_constant = self._value("time_constant").clamp_min(SHORTEST).unsqueeze(-1)
        left = torch.exp(-torch.tensor(edges, device=worked.device) / time_constant)  # (n, B + 1)
        heat = (self._gather(worked) * (left[..., :-1] - left[..., 1:])).sum(-1, keepdim=True)
        return self._scatter(memory, heat)

    def _gain_change(self, tensordict: TensorDictBase) -> Tensor:
        heat = self._gather(tensordict.get(self.memory)).squeeze(-1)
        return -(self._value("foldback") * heat).clamp_max(1.0)

    def _acting(self, command: Tensor, tensordict: TensorDictBase) -> Tensor:
        memory = tensordict.get(self.memory)
        heat = self._gather(memory)
        drive = drive_of(command, self.rest).clamp(-1.0, 1.0).unsqueeze(-1)
        time_constant = self._value("time_constant").clamp_min(SHORTEST).unsqueeze(-1)
        warmer = heat - (drive.square() - heat) * torch.expm1(-self.dt / time_constant)
        tensordict.set(self.memory + GIVEN, self._scatter(memory, warmer))
        return super()._acting(command, tensordict)

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        after.set(self.memory, before.get(self.memory + GIVEN))

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        state.set(self.memory, torch.zeros_like(state.get(keys.VELOCITY)[..., :1]))

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return {self.memory: numbers_spec(shape, 1, device=device)}
