"""Whether a simulator does what one must, tried out before it is used (contract 2)."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from traceback import walk_tb

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase, TransformedEnv

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import command_of, declared_by
from buggy_rl.core.vehicle import CONTROL_PERIOD, rotate
from buggy_rl.simulators.contract import (
    MIXED,
    OTHER,
    SIZES,
    SPEED,
    check_shape,
    check_step,
    gentle,
    reset,
    rolling,
    step,
    words,
)

OFF = 0.2  # [-] of the way driven, beyond which a reading of the axes is wrong,
RIGHT = 0.05  # and within which it is right
TURNED = 0.02  # [rad] of heading, in a run, from which its unit can be told


def axes_fault(pose: Tensor, velocity: Tensor, dt: float) -> str:
    """What is wrong of the axes of runs, and what to do; empty where nothing is.

    Args:
        pose: [B, T, 3] x, y, yaw.
        velocity: [B, T, 3] vx, vy, yaw rate.
        dt: Control period [s].
    """
    way = pose[:, 1:, :2] - pose[:, :-1, :2]
    mean = 0.5 * (velocity[:, 1:, :2] + velocity[:, :-1, :2]) * dt
    yaw = 0.5 * (pose[:, 1:, 2] + pose[:, :-1, 2])
    degree = math.pi / 180
    left = {
        "body": _left(way, rotate(mean, yaw)),
        "world": _left(way, mean),
        "degrees": _left(way, rotate(mean, degree * yaw)),
    }
    turned = (pose[:, -1, 2] - pose[:, 0, 2]).abs()  # (B,)
    rate = 0.5 * (velocity[:, 1:, 2] + velocity[:, :-1, 2])
    by_rate = (rate.sum(1) * dt).abs()
    car = int(by_rate.argmax())
    grown = float(turned[car] / by_rate[car].clamp_min(1e-9))
    in_degrees = float(by_rate[car]) > TURNED and abs(grown * degree - 1) < OFF
    if left["body"] <= OFF and not in_degrees:
        return ""
    if in_degrees or (left["degrees"] < RIGHT and left["degrees"] < left["world"]):
        return (
            f"its heading seems to be in degrees: at a heading of {float(pose[0, 0, 2]):g} a step "
            "moves it along another direction, or the heading changes by other than the yaw rate "
            "says; return yaw in rad and yaw rate in rad/s"
        )
    if left["world"] < RIGHT:
        return (
            "its velocity seems to be the world's: a step moves it along (vx, vy), whatever its "
            "heading is; return vx ahead and vy to the left of the car"
        )
    return ""


def _left(way: Tensor, expected: Tensor) -> float:
    """Root mean square distance over that driven [-]."""
    driven = way.square().sum(-1).mean().clamp_min(1e-12)
    return float(((way - expected).square().sum(-1).mean() / driven).sqrt())


CARS = 5  # that are tried out: one for each of these commands, full drive to both sides included
# Drive and steering: half, full and none, which with brakes is full brake; both locks.
DRIVES = ((0.5, 0.0), (1.0, 0.0), (0.0, 0.0), (0.5, 1.0), (0.5, -1.0))
BACKWARD = 2  # of them
TRIAL = 1.0  # [s] of the trial commands
ASKEW = 1.0  # [rad] heading at which axes are told apart
SETTLING = 10  # [steps] in which a car that was set down sideways comes to roll
FASTEST = 50.0  # [m/s] or [rad/s] that no car of this size comes near
TOGETHER = 30  # [steps] after which a command has acted, late ones too
SMALL = 1e-3  # [m/s] edits of vx; within a few of them the next one is a straight line of it
COARSE = 2e-4  # [m/s] distance from that line that is worth a word; float32 at 5 m/s has 5e-7
PERIOD = 0.2  # share by which a control period may seem off: a car also speeds up in it


def check_simulator(
    make: Callable[[int], EnvBase], name: str, dt: float = CONTROL_PERIOD
) -> list[str]:
    """Tries a simulator out before it is used (contract 2).

    Args:
        make: Builds it for a number of cars.
        name: What the user calls it.
        dt: Control period that it must have [s].

    Returns:
        Notes on what can be lived with.

    Raises:
        ValueError: It cannot be used; the message names it, what was found and what to do.
    """
    env = _built(make, name, dt)
    state = _set_down(env, name)
    _check_period(name, (state, check_step(env, name, state)), dt)
    check_axes(env, name, dt)
    return [*_odd(make, env, name, state), *_check_commands(env, name, state, dt)]


@contextmanager
def blaming(name: str) -> Iterator[None]:
    """Names the simulator where one of its own steps or resets fails; other errors pass.

    Raises:
        ValueError: It raised; that error is its `__cause__`.
    """
    try:
        yield
    except Exception as error:
        for frame, _ in walk_tb(error.__traceback__):
            env = frame.f_locals.get("self")
            own = isinstance(env, EnvBase) and not isinstance(env, TransformedEnv)
            if own and frame.f_code.co_name in ("_step", "_reset"):
                raise ValueError(
                    f"simulator {name}: {frame.f_code.co_name.strip('_')} raised "
                    f"{words(error)}; run it alone with the same commands to find out why"
                ) from error
        raise


def _commands(env: EnvBase) -> Tensor:
    """The trial commands [CARS, 2] of a simulator, whose rest may be at -1 or at 0."""
    command, action = declared_by(env), torch.tensor(DRIVES, device=env.device)
    action[:, 0] = command_of(action[:, 0], command.rest)
    if command.two_way:
        action[BACKWARD, 0] = -1.0
    return action


def _built(make: Callable[[int], EnvBase], name: str, period: float) -> EnvBase:
    try:
        env = make(CARS)
    except Exception as error:
        if str(error).startswith(f"simulator {name}"):  # `make_engine` tried it out, and says so
            raise
        raise ValueError(
            f"simulator {name} cannot be built for {CARS} cars: {words(error)}"
        ) from error
    if not isinstance(env, EnvBase):
        raise ValueError(
            f"simulator {name} is a {type(env).__name__}: its factory must return a TorchRL EnvBase"
        )
    if env.batch_size != torch.Size([CARS]):
        raise ValueError(
            f"simulator {name} has batch size {list(env.batch_size)} where [{CARS}] was asked for: "
            "factory(batch_size, device) must build that many cars"
        )
    dt = getattr(env, "dt", period)
    if abs(dt - period) > 1e-9:
        raise ValueError(
            f"simulator {name} has control period {dt:g} s: must be {period:g} s, that of the "
            f"recordings; set rate={1 / dt:g}, or build it with that period"
        )
    return env


def _set_down(env: EnvBase, name: str) -> TensorDictBase:
    """Cars as a reset with pose and velocity leaves them."""
    given = rolling(env, (2.0, -1.0, 0.0))  # heading along x
    state = reset(env, name, given)
    for key in (keys.POSE, keys.VELOCITY):
        check_shape(env, state.get(key, None), key, name, "reset")
        off = (state[key] - given[key]).abs().max()
        if not float(off) < 1e-3:
            raise ValueError(
                f"simulator {name} ignores the {key} that reset was given: {given[key][0].tolist()}"
                f" became {[round(v, 3) for v in state[key][0].tolist()]}; start there"
            )
    action = env.action_spec.shape if keys.ACTION in env.action_keys else None
    if action is None or action != torch.Size([CARS, SIZES[keys.ACTION]]):
        raise ValueError(
            f"simulator {name} has no 'action' of shape [{CARS}, 2] (throttle, steering): it has "
            f"{', '.join(map(str, env.action_keys))} of shape {list(env.action_spec.shape)}"
        )
    return state


def check_axes(env: EnvBase, name: str, dt: float) -> None:
    """What a simulator's own steps tell of its axes: pose against velocity, in a bend.

    Raises:
        ValueError: Its heading is in degrees, or its velocity is the world's.
    """
    given = rolling(env, (0.0, 0.0, ASKEW))
    states, action = [reset(env, name, given)], _commands(env)
    for _ in range(TOGETHER):
        states.append(step(env, name, states[-1], action))
    poses, velocities = (
        torch.stack([state[key] for state in states[SETTLING:]], 1).double()
        for key in (keys.POSE, keys.VELOCITY)
    )
    if fault := axes_fault(poses, velocities, dt):
        raise ValueError(f"simulator {name}: {fault}")


def _odd(
    make: Callable[[int], EnvBase], env: EnvBase, name: str, state: TensorDictBase
) -> list[str]:
    """What can be lived with: one environment at a time, coarse numbers."""
    notes = []
    if getattr(env, "one_at_a_time", False):
        notes.append(
            f"simulator {name} has one environment, which is stepped for each in turn: a batch "
            "would take a small part of the time"
        )
    coarse = _resolution(make, name, state)
    if coarse > COARSE:
        notes.append(
            f"simulator {name} rounds its velocities by {coarse:.1g} m/s: what is smaller "
            "drowns in that; compute in float64 and do not round"
        )
    return notes


def _resolution(make: Callable[[int], EnvBase], name: str, state: TensorDictBase) -> float:
    """How far vx a step later [m/s] is from a straight line over small edits of it."""
    edits = SMALL * torch.arange(-10.0, 11.0, device=state[keys.VELOCITY].device)
    env = make(len(edits))
    motion = {key: state[key][:1].expand(len(edits), 3) for key in (keys.POSE, keys.VELOCITY)}
    edited = reset(env, name, TensorDict(motion, [len(edits)]))
    edited[keys.VELOCITY] = edited[keys.VELOCITY] + edits.unsqueeze(-1) * _axis(0, edits)
    after = step(env, name, edited, gentle(env))[keys.VELOCITY][:, 0].double()
    felt, line = after - after.mean(), edits.double()
    rest = felt - line * (line @ felt) / line.square().sum()
    return float(rest.nan_to_num().abs().max())


def _axis(channel: int, beside: Tensor) -> Tensor:
    """Unit vector [3] along a channel, on the device of a tensor."""
    return torch.eye(3, device=beside.device)[channel]


def _check_period(name: str, ends: tuple[TensorDictBase, TensorDictBase], expected: float) -> None:
    """How far a step goes at a known speed says how long it is."""
    before, after = ends
    moved, vx = torch.stack(
        [
            (after.get(keys.POSE) - before.get(keys.POSE))[:, 0],
            0.5 * (after.get(keys.VELOCITY) + before.get(keys.VELOCITY))[:, 0],
        ]
    )
    period = float((moved / vx).quantile(0.5))
    if abs(period - expected) > PERIOD * expected:
        raise ValueError(
            f"simulator {name} seems to have a control period of {period:.3g} s, by how far a step "
            f"moves it at {SPEED} m/s; it must be {expected:g} s"
        )


def _check_commands(env: EnvBase, name: str, state: TensorDictBase, dt: float) -> list[str]:
    """A second of each command: numbers, no running away, different and independent motions."""
    action, start, early = _commands(env), state, state[keys.VELOCITY]
    rows = round(TRIAL / dt)
    for row in range(rows):
        state = step(env, name, state, action)
        early = state[keys.VELOCITY] if row < TOGETHER else early
        rate = state[keys.VELOCITY]
        fine = (rate.abs() < FASTEST).all(-1) & torch.isfinite(state[keys.POSE]).all(-1)
        if not bool(fine.all()):
            car = int(fine.int().argmin())
            what = "runs away" if bool(rate[car].isfinite().all()) else "returns NaN"
            raise ValueError(
                f"simulator {name} {what} {(row + 1) * dt:.2f} s after {SPEED} m/s "
                f"under throttle {action[car, 0]:g}, steering {action[car, 1]:g}: velocity "
                f"{[round(v, 1) for v in rate[car].tolist()]}"
            )
    driven = state[keys.VELOCITY]
    alike = [float((driven[a] - driven[b]).abs().max()) < 1e-3 for a, b in ((1, 2), (3, 4))]
    if all(alike):
        raise ValueError(
            f"simulator {name} moves alike whatever the commands: neither 'action' changes its "
            "velocity within a second; a simulator that ignores its actions cannot be diagnosed"
        )
    _check_apart(env, name, start, early, min(TOGETHER, rows))
    return [
        f"simulator {name} moves alike whatever the {command}: effects on it cannot be told"
        for command, same in zip(("throttle", "steering"), alike, strict=True)
        if same
    ]


def _check_apart(env: EnvBase, name: str, state: TensorDictBase, early: Tensor, rows: int) -> None:
    """The same commands but for that of one environment: the others move as before.

    Args:
        env: The simulator.
        name: What the user calls it.
        state: Where the trial commands began.
        early: Velocities [CARS, 3] after so many rows of them.
        rows: Steps.
    """
    action = _commands(env)
    action[0] = torch.tensor(OTHER)
    for _ in range(rows):
        state = step(env, name, state, action)
    mixed = float((state[keys.VELOCITY] - early)[1:].nan_to_num().abs().max())
    if mixed > MIXED:
        raise ValueError(
            f"simulator {name}: another command for one environment moved the others by "
            f"{mixed:.2g}; step every environment of a batch by itself"
        )
