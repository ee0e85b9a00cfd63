"""What a simulator with effects says the sensor would have shown: many parameter sets at once."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import Compose, EnvBase, TransformedEnv

from buggy_rl import keys
from buggy_rl.effects import CORRECTIONS, LAST_OF_KIND, ORDER, make_effect
from buggy_rl.effects.actuation.command import RememberingCommand
from buggy_rl.effects.base import Effect
from buggy_rl.estimation.segments import AHEAD, WARM_UP, Stretches
from buggy_rl.vehicle import rotate

MOST_CARS = 12_000  # rolled out at once, to bound memory

Values = Mapping[str, Mapping[str, Tensor]]
"""Effect -> parameter -> values [C], one a parameter set, or [C, N], one a stretch of each."""
Options = Mapping[str, Mapping[str, Any]]
"""Effect -> option -> value, as `measured_options` finds them."""


@dataclass(frozen=True)
class Player:
    """Plays the commands of stretches into a simulator and reads its sensor.

    Args:
        make: Builds the simulator for a number of cars.
        every: Rows between two readings.
        standing: Effects that are in every rollout, nearer to the engine than those on trial,
            with one value for all cars.
        options: Of effects on trial, by name: what they must know of this simulator.
    """

    make: Callable[[int], EnvBase]
    every: int = 10
    standing: Sequence[Effect] = ()
    options: Options = field(default_factory=dict)

    def instants(self, cut: Stretches) -> Tensor:
        """Rows [K] after the start that are read."""
        return torch.arange(self.every, cut.horizon + 1, self.every)

    @torch.no_grad()
    def play(
        self,
        cut: Stretches,
        effects: Values,
        parameters: Mapping[str, Tensor] | None = None,
        offset: Tensor | None = None,
        shift: Tensor | None = None,
    ) -> Tensor:
        """Readings minus measurements.

        Args:
            cut: N stretches.
            effects: Values of C parameter sets.
            parameters: The simulator's own, name -> [C] or [C, N].
            offset: [C] or [C, N] commands took effect this much later than they are stamped [s].
            shift: [C, 6] error of the start's pose (in the body frame) and velocity.

        Returns:
            [C, N, K, 6]: x, y [m] along and across the heading at the start, yaw [rad],
            vx, vy [m/s], yaw_rate [rad/s].
        """
        sets = _count(effects, parameters, offset, shift)
        per = max(1, MOST_CARS // len(cut))
        parts = []
        for first in range(0, sets, per):
            rows = slice(first, min(first + per, sets))
            parts.append(
                self._play(
                    cut,
                    {e: {p: v[rows] for p, v in ps.items()} for e, ps in effects.items()},
                    {p: v[rows] for p, v in (parameters or {}).items()},
                    None if offset is None else offset[rows],
                    None if shift is None else shift[rows],
                    rows.stop - rows.start,
                )
            )
        return torch.cat(parts)

    def _play(self, cut, effects, parameters, offset, shift, sets) -> Tensor:
        count = len(cut)
        cars = sets * count
        env, stack = self._environment(effects, parameters, cars, count)
        pose, velocity = _started(cut, stack, sets, shift)
        action = _commanded(cut, offset, sets)
        start = TensorDict({keys.POSE: pose[:, 0], keys.VELOCITY: velocity[:, 0]}, [cars])
        state = env.reset(start)
        if keys.ELAPSED in state.keys():  # noqa: SIM118  TensorDict has no `in`
            state[keys.ELAPSED] = cut.elapsed.repeat(sets).unsqueeze(-1)
        for effect in stack:
            if isinstance(effect, RememberingCommand) and effect.lasting and effect.active:
                told = cut.earlier[..., effect.channel].repeat(sets, 1)
                state[effect.memory] = effect.remembered(state[effect.memory], told)
        wanted = set((self.instants(cut) + WARM_UP).tolist())
        seen = []
        for row in range(cut.pose.shape[1]):
            if row <= WARM_UP:
                state[keys.POSE], state[keys.VELOCITY] = pose[:, row], velocity[:, row]
            if row in wanted:
                seen.append(reading(state))
            if row < cut.pose.shape[1] - 1:
                state[keys.ACTION] = action[:, row]
                state = env.step(state)["next"]
        read = torch.stack(seen, 1).view(sets, count, len(seen), 6)
        return _compared(read, cut, self.instants(cut))

    def _environment(self, effects, parameters, cars, count):
        each = {e: {p: _each(v, count) for p, v in ps.items()} for e, ps in effects.items()}
        own = {name: _each(v, count) for name, v in parameters.items()}
        return explained(self.make(cars), each, own, self.standing, self.options)


def _each(values: Tensor, count: int) -> Tensor:
    """Values [C] or [C, N] of each car [C * N]."""
    return values.repeat_interleave(count) if values.dim() == 1 else values.flatten()


def explained(
    simulator: EnvBase,
    effects: Values,
    parameters: Mapping[str, Tensor],
    standing: Sequence[Effect] = (),
    options: Options | None = None,
) -> tuple[TransformedEnv, list[Effect]]:
    """A simulator with other parameters and more effects, and all effects that it then has.

    Effects that the simulator has already stay, and all stand in the one order that is right:
    what acts on the motion before what senses it.

    Args:
        simulator: Of any number of cars; not changed.
        effects: Effect -> parameter -> value of each car.
        parameters: The simulator's own -> value of each car.
        standing: Further effects that are in it, with one value for all cars.
        options: Of `effects`, by name.

    Raises:
        ValueError: The simulator has one of the effects already, or transforms that are none.
    """
    # `with_parameters` of the whole would be the engine's: its effects would be gone.
    engine = simulator.base_env if isinstance(simulator, TransformedEnv) else simulator
    given = [effect.clone() for effect in (*effects_of(simulator), *standing)]
    if parameters:
        values = TensorDict(dict(parameters), engine.batch_size)
        engine = engine.with_parameters(values)  # type: ignore[operator]
    stack = [
        make_effect(name, (options or {}).get(name)).with_parameters(
            TensorDict(dict(values), engine.batch_size)
        )
        for name, values in effects.items()
    ]
    twice = sorted({e.name for e in given} & {e.name for e in stack})
    if twice:
        raise ValueError(f"the simulator has {', '.join(twice)} already: look for other effects")
    stack = sorted([*given, *stack], key=_place)
    env = TransformedEnv(engine, Compose([]), auto_unwrap=True)
    for effect in stack:
        env.append_transform(effect)
    return env, stack


def effects_of(simulator: EnvBase) -> list[Effect]:
    """Effects that a simulator has from the start, from its engine outwards.

    Raises:
        ValueError: It has transforms that are no effects.
    """
    if not isinstance(simulator, TransformedEnv):
        return []
    outer = simulator.transform
    found = list(outer) if isinstance(outer, Compose) else [outer]
    others = [type(t).__name__ for t in found if not isinstance(t, Effect)]
    if others:
        raise ValueError(
            f"a simulator may have effects over its engine, not {', '.join(others)}: those are a "
            "task's"
        )
    return found  # type: ignore[return-value]


def _place(effect: Effect) -> int:
    """From the engine outwards; corrections next to it, one's own with the last of their kind."""
    if effect.name in CORRECTIONS:
        return -1
    name = effect.name if effect.name in ORDER else LAST_OF_KIND[effect.kind]
    return ORDER.index(name)


def _count(effects, parameters, offset, shift) -> int:
    for values in effects.values():
        for value in values.values():
            return len(value)
    for value in (parameters or {}).values():
        return len(value)
    for value in (offset, shift):
        if value is not None:
            return len(value)
    return 1


def _started(cut: Stretches, stack: Sequence, sets: int, shift: Tensor | None):
    """True motion [C * N, WARM_UP + 1, 3] that the records show, as each set's sensor has it."""
    rows = slice(0, WARM_UP + 1 + AHEAD)
    pose = cut.smooth_pose[:, rows].repeat(sets, 1, 1)
    velocity = cut.smooth_velocity[:, rows].repeat(sets, 1, 1)
    for effect in reversed(stack):
        pose, velocity = effect.unsensed(pose, velocity, cut.dt)
    pose, velocity = pose[:, : WARM_UP + 1].clone(), velocity[:, : WARM_UP + 1].clone()
    if shift is not None:
        off = shift.repeat_interleave(len(cut), 0)  # (C * N, 6)
        pose[:, -1, :2] += rotate(off[:, :2], pose[:, -1, 2])
        pose[:, -1, 2] += off[:, 2]
        velocity[:, -1] += off[:, 3:]
    return pose, velocity


def _commanded(cut: Stretches, offset: Tensor | None, sets: int) -> Tensor:
    """Commands [C * N, L, 2] as they took effect, `offset` [C] or [C, N] s later than stamped."""
    action = cut.action
    if offset is None or not bool(offset.any()):
        return action.repeat(sets, 1, 1)
    length = action.shape[1]
    place = torch.arange(length) - (_each(offset, len(cut)) / cut.dt).unsqueeze(-1)  # (C * N, L)
    place = place.clamp(0, length - 1)
    before = place.floor().long().clamp_max(length - 2)
    all_ = action.repeat(sets, 1, 1)
    older, newer = (
        all_.gather(1, row.unsqueeze(-1).expand(-1, -1, 2)) for row in (before, before + 1)
    )
    return torch.lerp(older, newer, (place - before).unsqueeze(-1))


def reading(state: TensorDictBase) -> Tensor:
    """What the sensor shows of a state: pose and velocity [*, 6]."""
    pose = state.get(keys.MEASURED_POSE, None)
    velocity = state.get(keys.MEASURED_VELOCITY, None)
    pose = state[keys.POSE] if pose is None else pose
    velocity = state[keys.VELOCITY] if velocity is None else velocity
    return torch.cat([pose, velocity], -1)


def _compared(read: Tensor, cut: Stretches, instants: Tensor) -> Tensor:
    measured = torch.cat([cut.pose, cut.velocity], -1)[:, WARM_UP + instants]  # (N, K, 6)
    gap = read - measured
    heading = cut.smooth_pose[:, WARM_UP, 2].view(1, -1, 1)
    place = rotate(gap[..., :2], -heading.expand(gap.shape[:-1]))
    return torch.cat([place, gap[..., 2:]], -1)
