"""Surrogate gradients: the motion of one simulator with the Jacobians of a learned model."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import declared_by
from buggy_rl.core.parameters import Realisations
from buggy_rl.core.vehicle import Similarity, VehicleDimensions, integrate_pose
from buggy_rl.simulators import Factory, make_engine, simulator_name
from buggy_rl.simulators.base import Engine
from buggy_rl.simulators.learned.base import DynamicsModel
from buggy_rl.simulators.learned.engine import LearnedEngine


class SurrogateEngine(Engine):
    """A simulator without gradients that passes those of a learned model.

    v' = f(x, u),  dv'/d(x, u) = dg/d(h, u)  at the history h of velocities and commands of f,

    with the simulator f and the model g. The gradient of the pose is that of its integration from
    these velocities (`vehicle.integrate_pose`). Values are the simulator's to the last bit. Beside
    its latent state there is the model's `history`; readings are the model's, `out_of_range` [1]
    and `range_excess` [1]: beyond its training data the gradient is extrapolated. Without gradients
    (`torch.no_grad`) the model is not evaluated.

    Args:
        batch_size: Number of environments, or a shape.
        device: Where the state lives.
        parameters: Of the simulator that differ from its own.
        simulator: What moves the car: an engine, or what `make_engine` makes one of.
        model: What gives the gradient: a model, or the file of one.
        options: Further arguments of the simulator.

    Raises:
        ValueError: The simulator is no `Engine`, or the model is of another step or command.
    """

    def __init__(
        self,
        batch_size: int | Sequence[int] = (),
        device: torch.device | str = "cpu",
        parameters: Mapping[str, float] | None = None,
        *,
        simulator: Engine | str | Path | Factory,
        model: DynamicsModel | str | Path,
        **options: Any,
    ) -> None:
        if not isinstance(simulator, Engine):
            simulator = _made(simulator, batch_size, str(device), parameters, options)
        super().__init__(simulator.batch_size, simulator.device, dt=simulator.dt)
        self.simulator = simulator
        self.learned = LearnedEngine(self.batch_size, self.device, dt=self.dt, model=model)
        self.command = declared_by(simulator)
        if self.learned.command.plain != self.command.plain:
            raise ValueError(
                f"surrogate: the simulator takes the command {str(self.command)!r}, the model was "
                f"trained with {str(self.learned.command)!r}: take a model of the same command"
            )
        self.declared, self.values = simulator.declared, simulator.values
        self.reach, self.resets_alone = simulator.reach, simulator.resets_alone
        self._finish()

    def _latent_specs(self) -> dict[str, TensorSpec]:
        return {**self.simulator._latent_specs(), **self.learned._latent_specs()}

    def _reading_specs(self) -> dict[str, TensorSpec]:
        return {**self.simulator._reading_specs(), **self.learned._reading_specs()}

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        latent = self.simulator._rest_latent(pose, velocity)
        return {**latent, **self.learned._rest_latent(pose, velocity)}

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        with torch.no_grad():
            after = self.simulator._advance(state, action)
        history, kept = self.learned.remembered(state, action)
        after |= kept
        if torch.is_grad_enabled():
            pose, velocity = state[keys.POSE], state[keys.VELOCITY]
            following = _Surrogate.apply(after[keys.VELOCITY], self.learned.model(history))
            moved = integrate_pose(pose, velocity, following, self.dt)
            after[keys.VELOCITY] = following
            after[keys.POSE] = _Surrogate.apply(after[keys.POSE], moved)
        return after

    @property
    def _alike(self) -> bool:
        return self.simulator._alike

    def with_parameters(self, values: TensorDictBase) -> Self:
        simulator = self.simulator.with_parameters(values)
        return type(self)(simulator=simulator, model=self.learned.model)

    def to(self, device: torch.device | str | int) -> Self:
        """Moves the simulator and the model too."""
        for part in (self.simulator, self.learned):
            part.to(device)
        super().to(device)
        self.values = self.simulator.values
        return self

    def vehicle(self) -> VehicleDimensions:
        return self.simulator.vehicle()

    @property
    def similarity(self) -> Similarity:
        return self.simulator.similarity

    @property
    def realises(self) -> Realisations:
        return self.simulator.realises

    @property
    def half_step(self) -> dict[str, Any]:
        return self.simulator.half_step


class _Surrogate(torch.autograd.Function):
    """One tensor with the gradient of another, of the same shape."""

    @staticmethod
    def forward(ctx: Any, value: Tensor, carrier: Tensor) -> Tensor:
        return value.clone()

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[None, Tensor]:  # pyright: ignore
        return None, gradient


def _made(
    simulator: str | Path | Factory,
    batch_size: int | Sequence[int],
    device: str,
    parameters: Mapping[str, float] | None,
    options: dict[str, Any],
) -> Engine:
    """The engine of a simulator.

    Raises:
        ValueError: It is none.
    """
    made = make_engine(simulator, batch_size, device, parameters, **options)
    if not isinstance(made, Engine):
        raise ValueError(
            f"surrogate: {simulator_name(simulator)} is a {type(made).__name__}, not an Engine: "
            "make one by from_step, from_gymnasium or from_mjcf of buggy_rl.simulators"
        )
    return made
