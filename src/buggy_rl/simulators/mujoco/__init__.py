"""The MuJoCo buggy: a batched TorchRL engine and a dm_control task over the same model."""

import warnings

with warnings.catch_warnings():
    # Without a display dm_control's window library complains; nothing here opens a window.
    warnings.filterwarnings("ignore", message=".*DISPLAY.*")
    from buggy_rl.simulators.mujoco.engine import MujocoEngine

__all__ = ["MujocoEngine"]
