"""The parameter of a MuJoCo car that is off, by least squares: ours and `mujoco.sysid`'s.

Both play the same one-second windows of the same drives into the same engine, after the same
imposed warm-up, and compare at the same instants in the same units. `mujoco.sysid` without its
extra is an empty module: nothing here may touch it before `peer_row` has looked.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

import contextlib
import sys
import time

import mujoco
import numpy as np
import torch
from mujoco import sysid
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from buggy_rl import keys
from buggy_rl.engines.mujoco import MujocoEngine
from buggy_rl.estimation.segments import WARM_UP
from buggy_rl.identification.least_squares import FitConfig, fit
from buggy_rl.identification.open_loop import open_loop
from buggy_rl.identification.residuals import CHANNEL_SCALE, STEP
from buggy_rl.identification.table import block_numbers, thinned
from buggy_rl.parameters import Parameter
from buggy_rl.recordings.windows import filtered, local_parabola, relative_pose, windows
from diagnosing.drives import OFF, load
from diagnosing.job import Job, Row

WEIGHTS = 1 / np.array([CHANNEL_SCALE["position"], *CHANNEL_SCALE.values()])  # x, y, yaw, ...
CONFIG = FitConfig()
# sysid wants a compiled model beside a custom rollout: two commands in, six readings out.
SHELL = """
<mujoco>
  <worldbody>
    <body><joint name="along" type="slide"/><geom size="0.1" mass="1"/></body>
  </worldbody>
  <actuator>
    <general name="throttle" joint="along"/><general name="steering" joint="along"/>
  </actuator>
  <sensor><user name="reading" dim="6"/></sensor>
</mujoco>
"""


def peer_row(job: Job) -> Row:
    """Value and interval of the parameter that is off, and the time that it took."""
    kind, _, free = job.name.partition("_")
    if kind == "sysid" and not hasattr(sysid, "optimize"):
        raise ValueError("mujoco.sysid is empty: pip install 'mujoco[sysid]'")
    simulator = MujocoEngine(nthread=job.config.threads)
    wanted = job.config.parameter
    free_ones = [n for n in simulator.declared if n not in CONFIG.fixed or n == wanted]
    names = free_ones if free else [wanted]
    recordings = load(job.file(OFF), job.seconds)
    length = WARM_UP + round(CONFIG.horizon / recordings[0].dt) + 1
    smooth = [filtered(r, CONFIG.smoothing, local_parabola) for r in recordings]
    cut, soft = (thinned(windows(r, length, length), CONFIG.windows) for r in (recordings, smooth))
    begin, cpu = time.perf_counter(), time.process_time()
    method = _sysid if kind == "sysid" else _ours
    value, low, high = method(simulator, names, cut, soft[keys.VELOCITY])[wanted]
    seconds, used = time.perf_counter() - begin, time.process_time() - cpu
    return {
        **{"seconds": seconds, "cpu_seconds": used, "free": len(names)},
        **{"value": value, "low": low, "high": high},
    }


Estimates = dict[str, tuple[float, float, float]]
"""Parameter -> value and the ends of its 95 % interval."""


def _ours(simulator: MujocoEngine, names: list[str], cut, velocity: Tensor) -> Estimates:
    config = FitConfig(parameters=names)
    found = fit(simulator, cut, velocity, block_numbers(cut), config)
    return {e.parameter.name: (e.value, e.low, e.high) for e in found}


def _sysid(simulator: MujocoEngine, names: list[str], cut, velocity: Tensor) -> Estimates:
    """Its own optimiser and interval at their defaults but for two things.

    Parameters are scaled to their ranges, and the step of a finite difference is ours: an engine
    hands out float32, in which sysid's step of 1.5e-8 does not exist.
    """
    chosen = [simulator.declared[name] for name in names]
    rollout = EngineRollout(simulator, chosen, cut, velocity)
    parameters = sysid.ParameterDict()
    for p in chosen:
        place = (p.value - p.lower) / (p.upper - p.lower)
        parameters.add(sysid.Parameter(p.name, place, 0.0, 1.0))
    residual = sysid.build_residual_fn(
        models_sequences=[rollout.measured()],
        build_model=lambda _, __: rollout.shell,
        custom_rollout=rollout,
        modify_residual=rollout.residual,
        resample_true=False,
        n_threads=1,
    )
    with contextlib.redirect_stdout(sys.stderr):  # it prints every iteration
        found, result = sysid.optimize(parameters, residual, verbose=False, eps=STEP)
    left = residual(result.x, found.copy())[0]
    _, half = sysid.calculate_intervals(left, np.asarray(result.jac))
    estimates = {}
    for p, place, spread in zip(chosen, result.x, half, strict=True):
        width = p.upper - p.lower
        ends = (place, place - spread, place + spread)
        value, low, high = (float(p.lower + width * end) for end in ends)
        estimates[p.name] = (value, low, high)
    return estimates


class EngineRollout:
    """Plays our engine for sysid: columns of a finite difference and windows are one batch.

    Args:
        simulator: The engine.
        chosen: Parameters that are free, each scaled to its range.
        cut: [N, WARM_UP + H + 1] windows of drives.
        velocity: [N, WARM_UP + H + 1, 3] their velocities without noise.
    """

    def __init__(
        self,
        simulator: MujocoEngine,
        chosen: list[Parameter],
        cut: TensorDictBase,
        velocity: Tensor,
    ) -> None:
        self.simulator, self.chosen, self.cut = simulator, chosen, cut
        self.start = velocity[:, : WARM_UP + 1]
        self.shell = mujoco.MjModel.from_xml_string(SHELL)
        self.mapping = sysid.TimeSeries.compute_all_sensor_mapping(self.shell)
        self.lower = np.array([p.lower for p in chosen])
        self.width = np.array([p.upper - p.lower for p in chosen])
        self.instants = torch.arange(CONFIG.every, cut.batch_size[1] - WARM_UP, CONFIG.every)
        self.times = CONFIG.every * simulator.dt * np.arange(1, self._rows() + 1)

    def measured(self) -> "sysid.ModelSequences":
        """What the drives show, window after window, as one sequence."""
        spec = mujoco.MjSpec.from_string(SHELL)
        state = sysid.create_initial_state(self.shell, np.zeros(self.shell.nq))
        control = sysid.TimeSeries(self.times, np.zeros((len(self.times), self.shell.nu)))
        seen = self._seen(self.cut[:, WARM_UP:]).reshape(-1, 6)
        reading = sysid.TimeSeries(self.times, seen, self.mapping)
        return sysid.ModelSequences("car", spec, "drives", state, control, reading)

    def __call__(self, *, param_dicts, **_) -> "list[sysid.SystemTrajectory]":
        """A trajectory of each set of parameters."""
        places = np.stack([parameters.as_vector() for parameters in param_dicts])  # (C, P)
        values = torch.as_tensor(self.lower + places * self.width, dtype=torch.float32)
        sets, count = len(places), len(self.cut)
        columns = {
            p.name: values[:, column].repeat_interleave(count)
            for column, p in enumerate(self.chosen)
        }
        batch = TensorDict(columns, [sets * count])
        made = open_loop(
            lambda _: self.simulator.with_parameters(batch),
            self.cut.expand(sets, *self.cut.batch_size).reshape(sets * count, -1),
            self.start.repeat(sets, 1, 1),
            chunk=sets * count,
        )
        seen = self._seen(made).reshape(sets, -1, 6)
        return [self._trajectory(rows) for rows in seen]

    def residual(self, _params, predicted, measured, model, _all, **__):
        """Of one trajectory, in units of the channels' scale."""
        gap = sysid.weighted_diff(predicted.data, measured.data, model, WEIGHTS)
        return gap, predicted, measured

    def _trajectory(self, rows: np.ndarray) -> "sysid.SystemTrajectory":
        control = sysid.TimeSeries(self.times, np.zeros((len(rows), self.shell.nu)))
        return sysid.SystemTrajectory(
            model=self.shell,
            control=control,
            sensordata=sysid.TimeSeries(self.times, rows, self.mapping),
            initial_state=np.zeros(0),
            state=sysid.TimeSeries(self.times, self.times[:, None]),
        )

    def _seen(self, rollout: TensorDictBase) -> np.ndarray:
        """Readings [N, K, 6], places seen from the start."""
        pose = relative_pose(rollout[keys.POSE])[:, self.instants]
        velocity = rollout[keys.VELOCITY][:, self.instants]
        return torch.cat([pose, velocity], -1).double().numpy()

    def _rows(self) -> int:
        return len(self.cut) * len(self.instants)
