"""The MuJoCo buggy: a batched TorchRL engine and a dm_control task over the same model."""

from buggy_rl.engines.mujoco.engine import MujocoEngine

__all__ = ["MujocoEngine"]
