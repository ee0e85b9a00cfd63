"""Cars stepped by MuJoCo Warp: single precision, on Warp's CPU device or on a GPU.

Only `batches.make_cars` imports this module, since `mujoco-warp` is an optional package.
"""

# pyright: reportAttributeAccessIssue=false, reportMissingImports=false
# MuJoCo's compiled module has no type stubs; MuJoCo Warp may not be installed.

import copy
import sys
from collections.abc import Mapping
from pathlib import Path

import mujoco
import mujoco_warp
import numpy as np
import torch
import warp
from numpy.typing import NDArray
from torch import Tensor

from buggy_rl.simulators.mujoco.batches import SteppedCars
from buggy_rl.simulators.mujoco.car import CompiledCar

# Four tyres touch one floor: at most four contacts of at most three rows, and four struts at the
# end of their travel. Twice that, since MuJoCo Warp drops what does not fit.
CONTACTS, ROWS = 8, 32
# Constants that `set_const` derives from masses and inertias.
DERIVED = ("body_subtreemass", "body_invweight0", "dof_invweight0")
CHECK_EVERY = 100  # control periods between two looks at a GPU's state, each of which waits for it


def start_warp(device: torch.device) -> None:
    """Initialises Warp; says so on stderr where it has to compile everything first."""
    # Else a line for each of some 60 modules that it loads, and a warning where there is no GPU.
    warp.config.log_level = warp.LOG_WARNING if device.type == "cuda" else warp.LOG_ERROR
    warp.init()
    if not any(Path(warp.config.kernel_cache_dir or "").glob("*mujoco_warp*")):
        print("MuJoCo Warp compiles its kernels, once: half a minute or more", file=sys.stderr)


class WarpCars(SteppedCars):
    """See `batches.make_cars` and `batches.Cars`.

    On a GPU a step is recorded once as a CUDA graph. Steps there are not equal to the last bit:
    contacts are collected in the order in which threads find them.
    """

    dtype = torch.float32

    def __init__(
        self, car: CompiledCar, count: int, fields: Mapping[str, NDArray], device: torch.device
    ) -> None:
        self.device, self.timestep = device, car.timestep
        start_warp(device)
        self._warp_device = warp.device_from_torch(str(device))  # a device without index too
        model = copy.copy(car.model)
        # MuJoCo Warp has no automatic reset and refuses the flag that turns MuJoCo's off.
        model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        sizes = {name: len(field) for name, field in fields.items()}
        sizes |= dict.fromkeys(DERIVED, max(sizes.values(), default=1))
        with warp.ScopedDevice(self._warp_device):
            self._model = mujoco_warp.put_model(model, sizes)
            self._data = mujoco_warp.make_data(model, count, nconmax=CONTACTS, njmax=ROWS)
            for name, field in fields.items():
                getattr(self._model, name).assign(field.astype(np.float32))
            mujoco_warp.set_const(self._model, self._data)
            self._graph = self._recorded()
            warp.synchronize_device()  # what follows is in the order of PyTorch's stream
        self.qpos, self.qvel, self.xfrc_applied, self.qfrc_applied = (
            warp.to_torch(getattr(self._data, name))
            for name in ("qpos", "qvel", "xfrc_applied", "qfrc_applied")
        )
        self._unchecked = 0

    def array(self, tensor: Tensor) -> Tensor:
        return tensor.detach().to(self.device, self.dtype)

    def step(self) -> None:
        if self._graph is None:
            with warp.ScopedDevice(self._warp_device):
                mujoco_warp.step(self._model, self._data)
        else:
            stream = torch.cuda.current_stream(self.device)
            warp.capture_launch(self._graph, warp.stream_from_torch(stream))

    def lose_bad(self) -> None:
        pass  # a state that is not finite stays so

    def refuse_bad(self) -> None:
        self._unchecked += 1
        if self.device.type == "cuda" and self._unchecked < CHECK_EVERY:
            return
        self._unchecked = 0
        bad = ~torch.isfinite(self.qpos).all(-1) | ~torch.isfinite(self.qvel).all(-1)
        if bad.any():
            raise RuntimeError(
                f"the state of environment {int(bad.nonzero()[0])} is not finite: its state or its "
                "parameters are outside the range of the physics; check the last pose and velocity"
            )

    def _recorded(self) -> "warp.Graph | None":
        # In Warp's own stream: PyTorch's default stream cannot be recorded.
        if self.device.type != "cuda":
            return None
        mujoco_warp.step(self._model, self._data)  # compiles what a recording cannot
        with warp.ScopedCapture() as capture:
            mujoco_warp.step(self._model, self._data)
        mujoco_warp.reset_data(self._model, self._data)
        return capture.graph
