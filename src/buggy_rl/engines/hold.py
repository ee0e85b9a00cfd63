"""Hold-last: constant velocity. The baseline that every simulator must beat."""

from tensordict import TensorDictBase
from torch import Tensor

from buggy_rl import keys
from buggy_rl.engines.base import Engine
from buggy_rl.vehicle import integrate_pose


class HoldEngine(Engine):
    """Velocity stays, pose follows: v' = v."""

    def __init__(self, *args, **kwargs) -> None:
        super().__init__(*args, **kwargs)
        self._finish()

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        return {}

    def _advance(self, state: TensorDictBase, action: Tensor) -> dict[str, Tensor]:
        velocity = state[keys.VELOCITY]
        pose = integrate_pose(state[keys.POSE], velocity, velocity, self.dt)
        return {keys.POSE: pose, keys.VELOCITY: velocity.clone()}
