"""A simulator of a Gymnasium environment, which is set to a state before each step."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD
from buggy_rl.simulators.adapters.functions import Factory, FunctionsEngine, State

NAMES = ("x", "y", "yaw", "vx", "vy", "yaw_rate")
REST = "state"  # key of what else `env.unwrapped.state` holds
TRIAL = (0.4, 0.3)  # [-] drive and steering of the trial steps
OTHER = (-0.2, -0.5)  # [-] of those in between
BETWEEN = 40  # of them: delays of commands are shorter
REMEDY = (
    "give its class get_state() -> {'pose': (x, y, yaw), 'velocity': (vx, vy, yaw_rate), and all "
    "else that it remembers} and set_state(state), or pass get_state= and set_state=, functions "
    "of the environment; where env.unwrapped.state is a vector, name its entries: "
    "layout=('x', 'y', 'yaw', 'vx', 'vy', 'yaw_rate', ...)"
)


class GymnasiumCar:
    """Reset and step of an environment as functions of the state; see `from_gymnasium`."""

    def __init__(
        self,
        make: Callable[[], Any],
        get_state: Callable[[Any], State] | None,
        set_state: Callable[[Any, dict[str, Any]], Any] | None,
        action: Callable[[float, float], Any] | None,
        layout: Sequence[str],
    ) -> None:
        self.make, self.given, self.action = make, (get_state, set_state), action
        self.layout = tuple(layout)
        self._env: Any = None

    def __getstate__(self) -> dict[str, Any]:
        """What another process needs to make it anew."""
        return {**vars(self), "_env": None}

    def reset(self, pose: Any, velocity: Any) -> State:
        """State of a car at a pose [3] with a velocity [3]."""
        self._opened()
        return {**_copy(self._initial), keys.POSE: pose, keys.VELOCITY: velocity}

    def step(self, state: State, action: Any) -> State:
        """State a step later."""
        env = self._opened()
        self._write(env, dict(state))
        env.step(self._own_action(env, float(action[0]), float(action[1])))
        return self._read(env)

    def _opened(self) -> Any:
        if self._env is None:
            env = self.make()
            if not isinstance(env, gymnasium.Env):
                raise ValueError(f"make() returned a {type(env).__name__}: not a gymnasium.Env")
            env.reset(seed=0)
            self._read, self._write = self._accessors(env)
            self._env, self._initial = env, _copy(self._read(env))
            self._refuse_memory(_name(env))
        return self._env

    def _accessors(
        self, env: Any
    ) -> tuple[Callable[[Any], State], Callable[[Any, dict[str, Any]], Any]]:
        """What reads and what writes the state of an environment.

        Raises:
            ValueError: It offers no way to.
        """
        read, write = self.given
        if read is not None and write is not None:
            return read, write
        inner = env.unwrapped
        if callable(getattr(inner, "get_state", None)) and callable(
            getattr(inner, "set_state", None)
        ):
            return _get_own, _set_own
        if self.layout:
            lacking = [name for name in NAMES if name not in self.layout]
            size = np.size(getattr(inner, "state", ()))
            if not lacking and size == len(self.layout):
                return partial(_read_vector, self.layout), partial(_write_vector, self.layout)
            what = f"no {', '.join(lacking)}" if lacking else f"{len(self.layout)} names"
            raise ValueError(
                f"{_name(env)}: layout has {what}, env.unwrapped.state has {size} entries: name "
                f"each, {', '.join(NAMES)} among them, or {REMEDY.partition(';')[0]}"
            )
        raise ValueError(f"{_name(env)}: its state can be neither read nor set: {REMEDY}")

    def _refuse_memory(self, name: str) -> None:
        """Two steps from one state, with others in between.

        Raises:
            ValueError: They differ: it remembers what `get_state` does not give.
        """
        state = self._initial
        lacking = [key for key in (keys.POSE, keys.VELOCITY) if key not in state]
        if lacking:
            raise ValueError(f"{name}: get_state gives no {' and no '.join(lacking)}: {REMEDY}")
        first = _copy(self.step(_copy(state), TRIAL))
        for _ in range(BETWEEN):
            self.step(_copy(state), OTHER)
        second = self.step(_copy(state), TRIAL)
        for key, value in first.items():
            off = float(np.abs(np.asarray(second[key], float) - np.asarray(value, float)).max())
            if off > 0 or not np.isfinite(off):
                raise ValueError(
                    f"{name}: two steps from one state differ in {key!r} by {off:.3g}: it is "
                    "stochastic or remembers more than get_state gives; switch noise off, and add "
                    "to get_state and set_state what else a step reads (commands, filters, clocks)"
                )

    def _own_action(self, env: Any, throttle: float, steering: float) -> Any:
        if self.action is not None:
            return self.action(throttle, steering)
        space = env.action_space
        if not isinstance(space, Box) or space.shape != (2,) or not space.is_bounded():
            raise ValueError(
                f"{_name(env)}: its actions are {space}: pass action=, a function of throttle and "
                "steering in [-1, 1] that returns one of them"
            )
        share = 0.5 * (np.array([throttle, steering]) + 1)
        return (space.low + share * (space.high - space.low)).astype(space.dtype)


def from_gymnasium(
    make: Callable[[], Any],
    *,
    get_state: Callable[[Any], State] | None = None,
    set_state: Callable[[Any, dict[str, Any]], Any] | None = None,
    layout: Sequence[str] = (),
    action: Callable[[float, float], Any] | None = None,
    dt: float = CONTROL_PERIOD,
    command: str | Mapping[str, Any] = "throttle",
) -> Factory:
    """A simulator from a Gymnasium environment of a car.

    One environment is set to each car's state in turn, stepped, and read: rewards, observations and
    the end of an episode are ignored. Its state is found by the first of these that it offers:
    `get_state` and `set_state`, methods of these names, or `env.unwrapped.state` by `layout`.

    Args:
        make: Builds the environment, such as `lambda: gymnasium.make("my/Car-v0")`.
        get_state: env -> dict of `pose` (x, y, yaw; world frame, m and rad), `velocity` (vx, vy,
            yaw_rate; body frame) and all else that a step reads.
        set_state: env, such a dict -> nothing; the environment goes on from there.
        layout: Name of each entry of the vector `env.unwrapped.state`.
        action: Throttle and steering in [-1, 1] -> an action of the environment; by default a box
            of two, in this order, from its lower to its upper end.
        dt: Time that a step takes [s].
        command: Kind of the first command (docs/recordings.md): `throttle`: no reverse, -1 is no
            drive.

    Returns:
        factory(batch_size, device), which raises ValueError where the state cannot be read and set,
        or is not all of it.
    """
    car = GymnasiumCar(make, get_state, set_state, action, layout)
    return partial(FunctionsEngine, step=car.step, reset=car.reset, dt=dt, command=command)


def _name(env: Any) -> str:
    return f"environment {type(env.unwrapped).__name__}"


def _copy(state: Mapping[str, Any]) -> dict[str, Any]:
    return {key: np.array(value) for key, value in state.items()}


def _get_own(env: Any) -> State:
    return env.unwrapped.get_state()


def _set_own(env: Any, state: dict[str, Any]) -> None:
    env.unwrapped.set_state(state)


def _read_vector(layout: Sequence[str], env: Any) -> State:
    """`env.unwrapped.state` by the names of its entries."""
    vector = np.asarray(env.unwrapped.state, float).flatten()
    named = dict(zip(layout, vector, strict=True))
    rest = np.array([named[name] for name in layout if name not in NAMES])
    motion = np.array([named[name] for name in NAMES])
    return {keys.POSE: motion[:3], keys.VELOCITY: motion[3:], **({REST: rest} if rest.size else {})}


def _write_vector(layout: Sequence[str], env: Any, state: dict[str, Any]) -> None:
    inner = env.unwrapped
    named = dict(zip(NAMES, [*state[keys.POSE], *state[keys.VELOCITY]], strict=True))
    rest = iter(state.get(REST, ()))
    values = [named[name] if name in named else next(rest) for name in layout]
    kind = inner.state.dtype if isinstance(inner.state, np.ndarray) else float
    inner.state = np.array(values, kind).reshape(np.shape(inner.state))
