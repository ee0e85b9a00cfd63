"""The learned engine: a dynamics model, its memory, and the pose that follows from velocity."""

from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, TensorSpec

from buggy_rl.core import keys
from buggy_rl.core.vehicle import integrate_pose
from buggy_rl.simulators.base import Engine
from buggy_rl.simulators.learned.base import INPUTS, DynamicsModel
from buggy_rl.simulators.learned.factory import load_model


class LearnedEngine(Engine):
    """Steps a `DynamicsModel`, whose history is part of the state.

    `history` [rows - 1, 5] holds velocity and action of the steps before this one, oldest first.
    `out_of_range` [1]: the input is outside the model's training range; `range_excess` [1]: how
    far.

    Args:
        model: A model, or the file of one.
        args, common: As for `Engine`; there are no parameters.
    """

    resets_alone = True

    def __init__(self, *args: Any, model: DynamicsModel | str | Path, **common: Any) -> None:
        super().__init__(*args, **common)
        if isinstance(model, (str, Path)):
            model, about = load_model(model)
            if about.get("dt", self.dt) != self.dt:
                raise ValueError(
                    f"the model was trained at a step of {about['dt']} s, the engine runs at "
                    f"{self.dt} s"
                )
        self.model = model.to(self.device, torch.float32).eval().requires_grad_(False)
        self.command = self.model.command
        self._finish()

    def _latent_specs(self) -> dict[str, TensorSpec]:
        return self._number_specs({keys.HISTORY: (self.model.rows - 1, INPUTS)})

    def _reading_specs(self) -> dict[str, TensorSpec]:
        flag = Binary(1, shape=self._shape(1), dtype=torch.bool, device=self.device)
        return {keys.OUT_OF_RANGE: flag, **self._number_specs({keys.RANGE_EXCESS: (1,)})}

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        # The past is unknown: the same velocity, without drive and steering.
        idle = velocity.new_tensor([self.command.rest, 0.0])
        idle = idle.expand(*velocity.shape[:-1], 2)
        row = torch.cat([velocity, idle], -1).unsqueeze(-2)  # (*, 1, 5)
        return {keys.HISTORY: row.repeat_interleave(self.model.rows - 1, -2)}

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        history, kept = self.remembered(state, action)
        pose, velocity, following = state[keys.POSE], state[keys.VELOCITY], self.model(history)
        moved = integrate_pose(pose, velocity, following, self.dt)
        return {keys.POSE: moved, keys.VELOCITY: following, **kept}

    def remembered(self, state: TensorDictBase, action: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """What the model is asked at a state, and what is kept of it.

        Args:
            state: With `velocity` [*, 3] and `history` [*, rows - 1, 5].
            action: [*, 2] within its bounds.

        Returns:
            History [*, rows, 5] with the present row; the next `history`, and the readings.
        """
        row = torch.cat([state[keys.VELOCITY], action], -1)  # (*, 5)
        history = torch.cat([state[keys.HISTORY], row.unsqueeze(-2)], -2)  # (*, rows, 5)
        outside, excess = self.model.envelope.measured(row)
        return history, {
            keys.HISTORY: history[..., 1:, :].clone(),
            keys.OUT_OF_RANGE: outside,
            keys.RANGE_EXCESS: excess,
        }

    def _options(self) -> dict[str, Any]:
        return {"model": self.model}
