"""The parameter of a MuJoCo car that is off, by least squares: ours and `mujoco.sysid`'s.

Both roll the same one-second segments of the same recordings out in the same engine, after the same
imposed warm-up, and compare at the same instants in the same units.
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

import contextlib
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from mujoco import sysid

from buggy_rl.estimation.least_squares import STEP, FitConfig, fit_segments, least_squares_fit
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.proof.baselines.sysid import Residuals
from buggy_rl.recordings import Recording
from buggy_rl.simulators.mujoco import MujocoEngine
from diagnosing.drives import OFF, load
from diagnosing.job import Job, Row

CONFIG = FitConfig()
Estimates = dict[str, tuple[float, float, float]]
"""Parameter -> value and the ends of its 95 % interval."""


def peer_row(job: Job) -> Row:
    """Value and interval of the parameter that is off, and the time that it took."""
    kind, _, free = job.name.partition("_")
    if kind == "sysid" and not hasattr(sysid, "optimize"):  # without its extra an empty module
        raise ValueError("mujoco.sysid is empty: pip install 'mujoco[sysid]'")
    make = partial(MujocoEngine, nthread=job.config.threads)
    wanted = job.config.parameter
    free_ones = [n for n in make(1).declared if n not in CONFIG.fixed or n == wanted]
    names = free_ones if free else [wanted]
    recordings = load(job.file(OFF), job.seconds)
    begin, cpu = time.perf_counter(), time.process_time()
    method = _sysid if kind == "sysid" else _ours
    value, low, high = method(make, recordings, names)[wanted]
    seconds, used = time.perf_counter() - begin, time.process_time() - cpu
    return {
        **{"seconds": seconds, "cpu_seconds": used, "free": len(names)},
        **{"value": value, "low": low, "high": high},
    }


def _ours(
    make: Callable[[int], MujocoEngine], recordings: Sequence[Recording], names: list[str]
) -> Estimates:
    found = least_squares_fit(make, recordings, FitConfig(parameters=names))
    return {e.parameter.name: (e.value, e.low, e.high) for e in found.estimates}


def _sysid(
    make: Callable[[int], MujocoEngine], recordings: Sequence[Recording], names: list[str]
) -> Estimates:
    """Its own optimiser and interval at their defaults but for two things.

    Parameters are scaled to their ranges, and the step of a finite difference is ours: an engine
    returns float32, in which sysid's step of 1.5e-8 does not exist.
    """
    declared = make(1).declared
    chosen = [declared[name] for name in names]
    simulation = Simulation(make, every=CONFIG.every)
    residuals = Residuals(simulation, fit_segments(recordings, CONFIG), chosen)
    start = sysid.ParameterDict()
    for p in chosen:
        share = (p.value - p.lower) / (p.upper - p.lower)
        start.add(sysid.Parameter(p.name, share, 0.0, 1.0))
    with contextlib.redirect_stdout(sys.stderr):  # it prints every iteration
        _, result = sysid.optimize(start, residuals, verbose=False, eps=STEP)
    left = residuals(result.x, start)[0]
    _, half = sysid.calculate_intervals(left, np.asarray(result.jac))
    estimates = {}
    for p, share, spread in zip(chosen, result.x, half, strict=True):
        ends = (share, share - spread, share + spread)
        value, low, high = (float(p.lower + (p.upper - p.lower) * end) for end in ends)
        estimates[p.name] = (value, low, high)
    return estimates
