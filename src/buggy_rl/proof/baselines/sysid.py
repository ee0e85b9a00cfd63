"""MuJoCo's own system identification with everything free; it knows parameters, no effects."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mujoco import sysid
from scipy.special import stdtrit
from torchrl.envs import EnvBase, TransformedEnv

from buggy_rl.core.parameters import Parameter
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.least_squares import SCALES, STEP, scaled_settings
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments
from buggy_rl.proof.baselines.asked import open_question, unnamed
from buggy_rl.proof.baselines.retune import Move, farthest
from buggy_rl.simulators.mujoco import MujocoEngine

SEGMENTS = 16  # of a second, spread evenly
ITERATIONS = 6  # at most: each is a rollout of all segments for every parameter
DAMPING = (
    10.0  # growth of its damping at each refused step: by its own 1.26 it takes a hundred tries
)
EDGE = 2e-3  # of a parameter's range: no fit starts nearer to its ends
WEIGHTS = 1 / np.array(SCALES)  # of x, y, yaw, vx, vy, yaw_rate


def identified(seen: Path) -> dict[str, Any]:
    """Names the parameter that moved most, in units of its size, beyond its own interval.

    min sum |s (reading - measured)|^2 over one-second rollouts by `mujoco.sysid.optimize`, every
    parameter of the MuJoCo car free within its range, the channels' scales s those of `Fit`. The
    interval is `mujoco.sysid.calculate_intervals`. With baseline drives the parameters are fitted
    to those first, and what counts is how they move from there. The confidence is the share of the
    way that all parameters went. Other engines it does not know: `cannot_tell`.

    Raises:
        ImportError: MuJoCo lacks its extra.
    """
    question = open_question(seen)
    make = question.maker()
    if not isinstance(_engine(make(1)), MujocoEngine):
        return unnamed("cannot_tell", "mujoco.sysid fits MuJoCo models, and this is none")
    if not hasattr(sysid, "optimize"):  # without its extra it is an empty module
        raise ImportError("mujoco.sysid is empty: pip install 'buggy_rl[proof]'")
    if question.baseline:
        moves = _fitted(make, question.segments(question.baseline, SEGMENTS))
        values = {m.parameter.name: float(m.parameter.value_at(m.coordinate)) for m in moves}
        make = question.maker(values)
    found = _fitted(make, question.segments(question.recordings, SEGMENTS))
    return farthest([move for move in found if move.certain])


def _fitted(make: Callable[[int], EnvBase], segments: Segments) -> list[Move]:
    """How `mujoco.sysid` moves the parameters of a simulator."""
    declared = _engine(make(1)).declared
    library = Library([], declared)
    residuals = Residuals(Simulation(make), segments, list(declared.values()))
    start = sysid.ParameterDict()
    for p in declared.values():
        vector = (p.value - p.lower) / (p.upper - p.lower)
        start.add(sysid.Parameter(p.name, min(max(vector, EDGE), 1 - EDGE), 0.0, 1.0))
    # An engine hands out float32, in which sysid's own step of 1.5e-8 does not exist.
    options = {"eps": STEP, "mu_factor": DAMPING, "max_iters": ITERATIONS}
    _, result = sysid.optimize(start, residuals, output=io.StringIO(), **options)
    jacobian = np.asarray(result.jac)
    left = residuals(result.x, start)[0]
    half = sysid.calculate_intervals(left, jacobian)[1]
    spread = half / stdtrit(sum(map(len, left)) - jacobian.shape[1], 0.975)
    moves = []
    for p, vector, sd in zip(declared.values(), result.x, spread, strict=True):
        own, width = library.parameters[p.name], p.upper - p.lower
        value = p.lower + float(vector) * width
        moves.append(Move(own, float(own.coordinate(value)), float(sd) * width / own.size))
    return moves


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals as `mujoco.sysid.optimize` asks for them, many sets of parameters in one batch."""

    simulation: Simulation
    segments: Segments
    parameters: Sequence[Parameter]
    """Parameters that are free, each scaled to its range."""

    def __call__(self, x: np.ndarray, _params: Any) -> tuple[list[np.ndarray], None, None]:
        """Residuals [M] of vectors [P], or [M, C] of [P, C]."""
        vectors = np.atleast_2d(x.T)  # (C, P)
        settings = scaled_settings(self.parameters, vectors)
        residual = self.simulation.residuals(self.segments, settings).double().numpy()
        if not np.isfinite(residual).all():
            raise FloatingPointError("the MuJoCo car runs away within the ranges of its parameters")
        flat = (residual * WEIGHTS).reshape(len(vectors), -1)
        return [flat[0] if x.ndim == 1 else flat.T], None, None


def _engine(simulator: EnvBase) -> Any:
    """Engine below a simulator's effects."""
    return simulator.base_env if isinstance(simulator, TransformedEnv) else simulator
