"""The contract of a step, tried out: a function of its TensorDict, in every row by itself.

    x_{k+1} = f(x_k, u_k),  with all of x_k in the TensorDict

Engines of this package prove it in their tests; a user's own simulator is tried when it is made.
"""

import random
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import command_of, declared_by
from buggy_rl.core.stepping import reset_at, trajectory

SIZES = {keys.POSE: 3, keys.VELOCITY: 3, keys.ACTION: 2}
SPEED = 1.5  # [m/s] at which environments are set down
GENTLE = 0.25  # [-] drive that keeps a car rolling
OTHER = (0.8, 0.5)  # [-] drive and steering of the steps in between
BETWEEN = 4  # [steps] of them: a dead time up to this that is kept elsewhere is noticed
EDITS = {keys.POSE: (0.5, 0.5, 0.5), keys.VELOCITY: (1.0, 0.0, 0.0)}
FELT = 0.1  # share of an edit that must be left after a step; the rest may be lost to damping
SAME = 1e-5  # [m, rad, m/s, rad/s] by which equal steps may differ: a GPU adds in changing order
MIXED = 1e-4  # [m, rad, m/s, rad/s] by which rows may move one another; a batch's rounding
REPEATS = 12  # [steps] from one state, by which noise is told from memory
REMEDY = (
    "keep its whole state there (docs/extending.md): from_step, from_gymnasium and from_mjcf of "
    "buggy_rl.simulators do; for make_environment() take the engine 'mujoco'"
)


def refuse_stateful(env: EnvBase, name: str) -> None:
    """Tries out whether a step of a simulator depends on its TensorDict alone.

    It takes one reset and nine steps; no global random state is changed.

    Args:
        env: The simulator.
        name: What the user calls it.

    Raises:
        ValueError: Two steps from one TensorDict differ, an edited pose or velocity is not felt,
            or environments of the batch move one another; it says which, by how much and what to
            do. Or a reset or a step fails, or does not give pose and velocity.
    """
    with _random_states_kept(env.device):
        state = reset(env, name, rolling(env, (0.0, 0.0, 0.0)))
        for key in EDITS:
            check_shape(env, state.get(key, None), key, name, "reset")
        check_step(env, name, state)


def check_step(env: EnvBase, name: str, state: TensorDictBase) -> TensorDictBase:
    """Tries the contract out from one state; see `refuse_stateful`.

    Returns:
        The state one step of gentle drive later.
    """
    action = gentle(env)
    first = step(env, name, state, action)
    for key in EDITS:
        check_shape(env, first.get(key, None), key, name, "a step")
    edited = {key: step(env, name, _edited(state, key), action) for key in EDITS}
    other = step(env, name, state, action + _first_row(action) * (_other(env) - action))
    for _ in range(BETWEEN):
        step(env, name, state, _other(env))
    _refuse_memory(env, name, state, [first, step(env, name, state, action)])
    for key, after in edited.items():
        _refuse_unfelt(name, key, first, after)
    for after in (*edited.values(), other):
        _refuse_mixing(name, first, after)
    return first


def _refuse_memory(
    env: EnvBase, name: str, state: TensorDictBase, steps: list[TensorDictBase]
) -> None:
    """Refuses unequal steps from one state, as noise or as memory."""
    key, apart = max(((k, _apart(steps[0][k], steps[1][k])) for k in EDITS), key=lambda p: p[1])
    if apart <= SAME:
        return
    more = [step(env, name, state, gentle(env))[key] for _ in range(REPEATS)]
    found = f"simulator {name}: two steps from one TensorDict differ in {key!r} by {apart:.3g}: "
    if scatters([steps[1][key], *more]):
        raise ValueError(
            f"{found}it is stochastic, it draws random numbers inside its step; take them out, "
            "noise belongs to the sensing (docs/extending.md)"
        )
    raise ValueError(f"{found}it remembers what is not in the TensorDict; {REMEDY}")


def scatters(results: Sequence[Tensor]) -> bool:
    """Whether results of equal steps, in their order, are noise and not a memory that goes on.

    Differences d_k of successive results have E[d_k d_{k+1}] = -variance for white noise; where
    each step goes on from the one before, successive differences agree.
    """
    change = torch.stack(list(results)).double().nan_to_num().diff(dim=0)
    return float((change[1:] * change[:-1]).sum()) < 0.0


def _refuse_unfelt(name: str, key: str, first: TensorDictBase, after: TensorDictBase) -> None:
    """Refuses a step of which the first row does not begin where it was set."""
    edit = torch.tensor(EDITS[key]).double()
    felt = _rows(after[key])[0] - _rows(first[key])[0]
    share, size = float((felt[edit > 0] / edit[edit > 0]).min()), float(edit.max())
    if share < FELT:
        raise ValueError(
            f"simulator {name} does not honour an edited {key}: {size:g} more was "
            f"{size * share:.2g} more after one step; begin each step with the {key} that "
            "it is given (docs/extending.md)"
        )


def _refuse_mixing(name: str, first: TensorDictBase, after: TensorDictBase) -> None:
    """Refuses a step in which more rows change than the first, whose input alone changed."""
    moved = max(_apart(_rows(first[key])[1:], _rows(after[key])[1:]) for key in EDITS)
    if moved > MIXED:
        raise ValueError(
            f"simulator {name}: another pose, velocity or command of one environment moved the "
            f"others by {moved:.2g}; step every environment of a batch by itself "
            "(docs/extending.md)"
        )


@contextmanager
def _random_states_kept(device: torch.device | None) -> Iterator[None]:
    """Puts the global generators of PyTorch, NumPy and Python back as they were."""
    of_numpy, of_python = np.random.get_state(), random.getstate()
    devices = [device] if device is not None and device.type == "cuda" else []
    try:
        with torch.random.fork_rng(devices=devices):
            yield
    finally:
        np.random.set_state(of_numpy)
        random.setstate(of_python)


def rolling(env: EnvBase, pose: tuple[float, float, float]) -> TensorDict:
    """Pose and velocity [*, 3] of environments that all roll ahead at `SPEED`."""
    rows = {keys.POSE: torch.tensor(pose), keys.VELOCITY: torch.tensor([SPEED, 0.0, 0.0])}
    given = {key: row.expand(*env.batch_size, 3).clone() for key, row in rows.items()}
    return TensorDict(given, env.batch_size).to(env.device or "cpu")


def gentle(env: EnvBase) -> Tensor:
    """A little drive [*, 2], wheels straight."""
    return _command(env, GENTLE, 0.0)


def _other(env: EnvBase) -> Tensor:
    return _command(env, *OTHER)


def _command(env: EnvBase, drive: float, steering: float) -> Tensor:
    command = [command_of(drive, declared_by(env).rest), steering]
    return torch.tensor(command, device=env.device).expand(*env.batch_size, 2)


def _edited(state: TensorDictBase, key: str) -> TensorDictBase:
    """A copy whose first row has another pose or velocity."""
    value, edited = state[key], state.clone()
    edit = torch.tensor(EDITS[key], dtype=value.dtype, device=value.device)
    return edited.set(key, value + _first_row(value) * edit)


def _first_row(like: Tensor) -> Tensor:
    """1 in the first environment of a batch, else 0; [*, 1]."""
    rows = torch.zeros(like[..., :1].numel(), dtype=like.dtype, device=like.device)
    rows[0] = 1.0
    return rows.view_as(like[..., :1])


def _rows(value: Tensor) -> Tensor:
    return value.reshape(-1, value.shape[-1]).double().cpu()


def _apart(one: Tensor, other: Tensor) -> float:
    """Largest difference; 0 of nothing."""
    difference = (one.nan_to_num() - other.nan_to_num()).abs()
    return float(difference.max()) if difference.numel() else 0.0


def check_shape(env: EnvBase, value: Tensor | None, key: str, name: str, source: str) -> None:
    """Refuses what a reset or a step gives in place of pose or velocity.

    Raises:
        ValueError: It is not there, or has another shape.
    """
    expected = [*env.batch_size, SIZES[key]]
    if value is None:
        raise ValueError(f"simulator {name}: {source} gives no {key!r}; it must give {expected}")
    if list(value.shape) != expected:
        raise ValueError(
            f"simulator {name}: {source} gives {key!r} of shape {list(value.shape)}, expected "
            f"{expected}"
        )


def words(error: BaseException) -> str:
    """Kind and first line of an error."""
    line = (str(error).splitlines() or [""])[0]
    return f"{type(error).__name__}: {line}" if line else type(error).__name__


def reset(env: EnvBase, name: str, given: TensorDictBase) -> TensorDictBase:
    """State after a reset with pose and velocity.

    Raises:
        ValueError: The simulator raised something; the message names it.
    """
    try:
        return reset_at(env, given.clone())
    except Exception as error:
        raise ValueError(
            f"simulator {name}: a reset with pose and velocity raised {words(error)}"
        ) from error


def step(env: EnvBase, name: str, state: TensorDictBase, action: Tensor) -> TensorDictBase:
    """State one step later; the given one is left as it is.

    Raises:
        ValueError: The simulator raised something; the message names it.
    """

    def act(_: int, now: TensorDictBase) -> TensorDictBase:
        return now.set(keys.ACTION, action.clone())

    try:
        _, after = trajectory(env, state.clone(), act, 1)
        return after
    except Exception as error:
        raise ValueError(f"simulator {name}: a step raised {words(error)}") from error
