"""MuJoCo's own system identification with everything free; it knows parameters, no effects."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mujoco import sysid
from torchrl.envs import EnvBase, TransformedEnv

from buggy_rl.core.parameters import Parameter
from buggy_rl.effects.base import EffectParameter
from buggy_rl.estimation.evidence import INDEPENDENT
from buggy_rl.estimation.hypothesis import OWN, Library
from buggy_rl.estimation.least_squares import SCALES, STEP, scaled_settings
from buggy_rl.estimation.noise_model import FAR
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments
from buggy_rl.proof.baselines.asked import named, open_question, parameter_interval, unnamed
from buggy_rl.proof.baselines.retune import LEAST, MOVED
from buggy_rl.proof.cases.equivalents import meant
from buggy_rl.simulators.mujoco import MujocoEngine

SEGMENTS = 24  # of a second, spread evenly
ITERATIONS = 8  # at most: each is a rollout of all segments for every parameter
DAMPING = (
    10.0  # growth of its damping at each refused step: by its own 1.26 it takes a hundred tries
)
EDGE = 2e-3  # of a parameter's range: no fit starts nearer to its ends
WEIGHTS = 1 / np.array(SCALES)  # of x, y, yaw, vx, vy, yaw_rate


def identified(seen: Path) -> dict[str, Any]:
    """Names the effect, or the parameter, along which the fit went.

    min sum |s (reading - measured)|^2 over one-second rollouts by `mujoco.sysid.optimize`, every
    parameter of the MuJoCo car free within its range, the channels' scales s those of
    `estimation.least_squares`. The fit moves by D with the curvature H = J^T J / s^2 at its end, of
    which the share `INDEPENDENT` counts, as the errors of a segment grow together. An effect that
    is realised by parameters has a direction d among them, a parameter that is none its own axis.
    What is named gains most of the fit, (d^T H D)^2 / (2 d^T H d), as long as that is `LEAST` nats
    and its number d^T H D / d^T H d is `MOVED` prior scales. The confidence is its share of what
    the whole fit gains. Other engines it does not know: `cannot_tell`.

    Raises:
        ImportError: MuJoCo lacks its extra.
    """
    question = open_question(seen)
    simulation = question.corrected
    engine = _engine(simulation.make(1))
    if not isinstance(engine, MujocoEngine):
        return unnamed("cannot_tell", "mujoco.sysid fits MuJoCo models, and this is none")
    if not hasattr(sysid, "optimize"):  # without its extra it is an empty module
        raise ImportError("mujoco.sysid is empty: pip install 'buggy_rl[proof]'")
    library = Library(None, engine.declared, realises=engine.realises)
    fit = identify(simulation, question.segments(question.recordings, SEGMENTS), engine.declared)
    gains = {way: fit.gain(way.direction) for way in directions(library, engine.declared)}
    best = max(gains, key=lambda way: gains[way])
    number, spread = fit.along(best.direction)
    note = f"{best.name} gains {gains[best]:.1f} nats of {fit.total:.1f}"
    if gains[best] < LEAST or abs(number) < MOVED:
        return unnamed("no_mismatch", note)
    said = parameter_interval(best.number, number, spread)
    numbers = {best.number.name: said} if best.own_number else {}
    share = min(1.0, gains[best] / fit.total)
    return named("wrong_parameters", best.name, share, numbers, [note])


@dataclass(frozen=True, eq=False)
class Direction:
    """A way that parameters can go together."""

    name: str
    """Effect, or a parameter as `parameter:NAME`."""
    number: EffectParameter
    """Number that says how far."""
    direction: np.ndarray
    """[P] change of the parameters, in shares of their ranges, by one prior scale of it."""
    own_number: bool = True
    """Whether the number is one of the effect's."""


def directions(library: Library, declared: Mapping[str, Parameter]) -> list[Direction]:
    """Ways of the effects that are a change of parameters, and of each parameter by itself."""
    width = np.array([p.upper - p.lower for p in declared.values()])
    given = np.array([p.value for p in declared.values()])
    found = []
    for effect in library.inside.changes:
        [number] = library.numbers(effect)
        at = {effect: {number.name: number.value + number.probe}}
        moved = {**dict(zip(declared, given, strict=True)), **library.inside.values(at, {})}
        change = np.array([moved[name] for name in declared]) - given
        size = float(number.coordinate(number.value + number.probe))
        found.append(Direction(effect, number, change / width / size))
    for place, name in enumerate(declared):
        own, axis = library.parameters[name], np.zeros(len(declared))
        axis[place] = own.size / width[place]
        effect = meant(OWN + name)
        if effect not in library.inside.changes:
            found.append(Direction(effect, own, axis, effect.startswith(OWN)))
    return found


@dataclass(frozen=True, eq=False)
class Identified:
    """What `mujoco.sysid` made of some segments."""

    move: np.ndarray
    """[P] move of the parameters, in shares of their ranges."""
    curvature: np.ndarray
    """[P, P] J^T J over the variance of the residuals that are left, of those that count."""

    @property
    def total(self) -> float:
        """Gain of the whole fit, to second order [nats]."""
        return 0.5 * float(self.move @ self.curvature @ self.move)

    def along(self, direction: np.ndarray) -> tuple[float, float]:
        """How far the fit went along a direction [P], and the standard deviation of that."""
        curvature = float(direction @ self.curvature @ direction)
        if curvature <= 0:
            return 0.0, float("inf")
        return float(direction @ self.curvature @ self.move) / curvature, curvature**-0.5

    def gain(self, direction: np.ndarray) -> float:
        """Part of the total that a direction [P] alone gains [nats]."""
        number, spread = self.along(direction)
        return 0.5 * (number / spread) ** 2


def identify(
    simulation: Simulation, segments: Segments, declared: Mapping[str, Parameter]
) -> Identified:
    """Fits all parameters of a simulator to segments by `mujoco.sysid`."""
    residuals = Residuals(simulation, segments, list(declared.values()))
    start = sysid.ParameterDict()
    for p in declared.values():
        scaled = (p.value - p.lower) / (p.upper - p.lower)
        start.add(sysid.Parameter(p.name, min(max(scaled, EDGE), 1 - EDGE), 0.0, 1.0))
    begin = start.as_vector()
    # An engine hands out float32, in which sysid's own step of 1.5e-8 does not exist.
    options = {"eps": STEP, "mu_factor": DAMPING, "max_iters": ITERATIONS}
    _, result = sysid.optimize(start, residuals, output=io.StringIO(), **options)
    jacobian = np.asarray(result.jac)
    [left] = residuals(result.x, start)[0]
    variance = float(left @ left) / (len(left) - len(begin))
    return Identified(result.x - begin, INDEPENDENT * jacobian.T @ jacobian / variance)


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals as `mujoco.sysid.optimize` asks for them, many sets of parameters in one batch."""

    simulation: Simulation
    segments: Segments
    parameters: Sequence[Parameter]
    """Parameters that are free, each scaled to its range."""

    def __call__(self, x: np.ndarray, _params: Any) -> tuple[list[np.ndarray], None, None]:
        """Residuals [M] of vectors [P], or [M, C] of [P, C]; where a car runs away, large ones."""
        vectors = np.atleast_2d(x.T)  # (C, P)
        settings = scaled_settings(self.parameters, vectors)
        residual = self.simulation.residuals(self.segments, settings).double().numpy()
        residual = np.clip(np.nan_to_num(residual, nan=FAR), -FAR, FAR)
        flat = (residual * WEIGHTS).reshape(len(vectors), -1)
        return [flat[0] if x.ndim == 1 else flat.T], None, None


def _engine(simulator: EnvBase) -> Any:
    """Engine below a simulator's effects."""
    return simulator.base_env if isinstance(simulator, TransformedEnv) else simulator
