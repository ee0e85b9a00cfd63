"""Rollouts of a simulator along segments: many parameter sets at once, each a part of the batch."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any, cast

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.kernels import LANES
from buggy_rl.core.stepping import reset_at, trajectory
from buggy_rl.core.vehicle import rotate
from buggy_rl.effects.actuation.command import RememberingCommand
from buggy_rl.effects.actuation.supply import ThermalFoldback
from buggy_rl.effects.base import Effect
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.estimation.bare import BareEnv, Rows
from buggy_rl.estimation.segments import LATEST, WORKED, Segments
from buggy_rl.estimation.workers import Result, Workers
from buggy_rl.simulators.base import Engine
from buggy_rl.task.augment import Options, Values, augmented

MOST_ENVIRONMENTS = 12_000  # stepped at once, to bound memory
SPARE = 32  # one more in so many fills the lanes of kernels, which else copy all to add it
AN_EFFECT = 400  # [environments] 0.3 ms of an effect over 0.8 us of a reference car


@dataclass(frozen=True)
class ParameterSets:
    """Numbers of C parameter sets, of shape [C], or [C, N] with one for each segment."""

    effects: Values = field(default_factory=dict)
    """Effect -> parameter -> values."""
    parameters: Mapping[str, Tensor] = field(default_factory=dict)
    """The simulator's own, by name."""
    clock_offset: Tensor = field(default_factory=lambda: torch.zeros(1))
    """[s] by which commands act later than they are stamped."""

    def __len__(self) -> int:
        """Number of sets (C)."""
        values = [v for parameters in self.effects.values() for v in parameters.values()]
        return len(next(iter((*values, *self.parameters.values(), self.clock_offset))))

    def map(self, change: Callable[[Tensor], Tensor]) -> "ParameterSets":
        """Sets with every tensor changed."""
        return ParameterSets(
            {e: {p: change(v) for p, v in values.items()} for e, values in self.effects.items()},
            {name: change(v) for name, v in self.parameters.items()},
            change(self.clock_offset),
        )


EVERY = 0.1  # [s] between two readings
OFF = (5e-4, 5e-4, 2.5e-3)  # [m/s, m/s, rad/s] by which a velocity is moved for a derivative
AS_GIVEN = ParameterSets()
ALONE = Workers(1)


def tell_nobody(environments: int, rows: int) -> None:
    """Tells nobody of a rollout that has ended."""


@dataclass(frozen=True, eq=False)
class LinearStep:
    """A step of a rollout of N segments, and how it depends on the velocity that it starts from."""

    pose: Tensor
    """[2, N, 3] true pose before and after it."""
    velocity: Tensor
    """[2, N, 3] true velocity."""
    slope: Tensor
    """[N, 3, 3] derivative of the velocity after it by that before."""
    read: Tensor
    """[N, 6] what the sensor shows after it."""


@dataclass(frozen=True)
class Simulation:
    """Rolls a simulator out along segments and reads its sensor.

    Rollouts run on the simulator's device. Segments, parameter sets and what is returned are on the
    CPU, where fits and their small linear algebra in double precision are computed.
    """

    make: Callable[[int], EnvBase]
    """Builds the simulator for a number of environments."""
    every: int = 0
    """Rows between two readings; 0 for those of `EVERY`."""
    standing: Sequence[Effect] = ()
    """Effects in every rollout, with one value for all environments; or a residual of each one."""
    options: Options = field(default_factory=dict)
    """Options of effects under test: what they must know of this simulator."""
    workers: Workers = ALONE
    """Processes among which parameter sets are divided; then `make` and effects can be pickled."""
    rolled: Callable[[int, int], None] = tell_nobody
    """Told of every rollout when it has ended: environments and steps."""

    @property
    def alone(self) -> "Simulation":
        """Simulation in one process that tells nobody, which can be pickled."""
        return replace(self, workers=ALONE, rolled=tell_nobody)

    def apart(
        self,
        function: Callable[..., Result],
        tasks: Sequence[tuple[Any, ...]],
        seconds: float = math.inf,
    ) -> list[Result]:
        """Results of a function of a simulation, this one, for tasks that do not need each other.

        A chain of rollouts of few environments takes a process as long as one of many: such chains
        are rolled out beside each other.

        Args:
            function: Of a simulation and a task; can be pickled.
            tasks: Its other arguments, one tuple a call; can be pickled.
            seconds: That one of them is expected to take; for little, no process is started.
        """
        results = []
        counted = partial(_counted, function, self.alone)
        for result, rolled in self.workers.results(counted, tasks, seconds):
            results.append(result)
            for environments, rows in rolled:
                self.rolled(environments, rows)
        return results

    def instants(self, segments: Segments) -> Tensor:
        """Rows [K] after the start that are read."""
        every = self.every or max(1, round(EVERY / segments.dt))
        return torch.arange(every, segments.horizon + 1, every)

    def residuals(
        self,
        segments: Segments,
        settings: ParameterSets = AS_GIVEN,
        start_error: Tensor | None = None,
    ) -> Tensor:
        """Readings minus measurements, positions along and across the heading at the start.

        Args:
            segments: N of them.
            settings: C parameter sets.
            start_error: [C, 6] error of the start's pose (in the body frame) and velocity.

        Returns:
            [C, N, K, 6]: x, y [m], yaw [rad], vx, vy [m/s], yaw_rate [rad/s].
        """
        read = self.readings(segments, settings, start_error)
        return along_heading(
            read - segments.measured[:, segments.start + self.instants(segments)], segments
        )

    def readings(
        self,
        segments: Segments,
        settings: ParameterSets = AS_GIVEN,
        start_error: Tensor | None = None,
    ) -> Tensor:
        """What the sensor shows at the instants, [C, N, K, 6] pose (world) and velocity."""
        sets = len(settings) if start_error is None else len(start_error)
        settings = settings.map(lambda v: v.expand(sets, *v.shape[1:]))
        shares = self._shares(sets, len(segments), len(settings.effects))
        each = [_part(settings, start_error, r) for r in shares]
        read = torch.cat(self.workers.results(partial(self.alone._readings, segments), each))
        self.rolled(sets * len(segments), segments.pose.shape[1] - 1)
        return read

    def _shares(self, sets: int, count: int, effects: int) -> list[slice]:
        """Sets that are rolled out together: bounded by memory, and divided among workers."""
        parts = math.ceil(sets * count / MOST_ENVIRONMENTS)
        busy = min(sets, self.workers.busy(sets * count + AN_EFFECT * effects))
        parts = busy * math.ceil(parts / busy)
        per = math.ceil(sets / min(parts, sets))
        return [slice(first, first + per) for first in range(0, sets, per)]

    def _readings(
        self, segments: Segments, settings: ParameterSets, start_error: Tensor | None
    ) -> Tensor:
        """Readings of a part of the sets, with as many environments more as fill the lanes."""
        sets, count = len(settings), len(segments)
        more = -(sets * count) % LANES
        full = not more or start_error is not None or self._of_each
        if full or SPARE * more > sets * count:
            return self._rolled_out(segments, settings, start_error)
        row = torch.cat([torch.arange(count).repeat(sets), torch.zeros(more, dtype=torch.long)])
        each = settings.map(lambda v: _each(v, count))
        each = each.map(lambda v: torch.cat([v, v[:1].expand(more)]).unsqueeze(0))
        read = self._rolled_out(segments[row], each, None)[0, : sets * count]
        return read.view(sets, count, *read.shape[1:])

    @property
    def _of_each(self) -> bool:
        """Whether a residual that stands is another one in each environment."""
        return any(isinstance(e, ResidualAcceleration) and e.of_each for e in self.standing)

    @torch.no_grad()
    def _rolled_out(
        self, segments: Segments, settings: ParameterSets, start_error: Tensor | None
    ) -> Tensor:
        sets, count = len(settings), len(segments)
        env, stack = self._environment(settings, count)
        segments = segments.to(_device(env))
        told = _told(segments, stack, sets)
        pose, velocity = _start(segments, stack, sets, start_error, told)
        action = _commands(segments, settings.clock_offset)

        bare, alike = BareEnv.of(env.base_env, stack), segments.start
        if told.device.type != "meta":  # without content all sensors may be prompt
            alike = int(told.min())

        def act(row: int, state: TensorDictBase) -> TensorDictBase:
            if row <= alike:
                _impose(state, pose[:, row], velocity[:, row])
            elif row <= segments.start:
                _impose(state, pose[:, row], velocity[:, row], row <= told)
            if bare is not None:
                bare.imposed = row < alike
            return state.set(keys.ACTION, action[:, row])

        state = self._reset(bare or env, stack, segments, pose[:, 0], velocity[:, 0])
        wanted = set((self.instants(segments) + segments.start).tolist())
        begin = cast(Any, state if bare is None else Rows(state.items()))
        states = trajectory(bare or env, begin, act, action.shape[1] - 1)
        seen = [sensed(state) for row, state in enumerate(states) if row in wanted]
        return torch.stack(seen, 1).view(sets, count, len(seen), 6).cpu()

    def single_steps(
        self, segments: Segments, settings: ParameterSets = AS_GIVEN
    ) -> Iterator[tuple[int, Tensor, Tensor]]:
        """Steps from the measured motion, imposed at every row, so that latent states follow it.

        Yields:
            Row k, the motion [2, C * N, 6] that is imposed there and at the next row, and that a
            step later as the engine has it [C * N, 6]; rows from their start to the last but one.
        """
        sets = len(settings)
        env, stack = self._environment(settings, len(segments))
        segments = segments.to(_device(env))
        pose, velocity = (
            x.repeat(sets, 1, 1) for x in (segments.smooth_pose, segments.smooth_velocity)
        )
        for effect in reversed(stack):
            pose, velocity = effect.unsensed(pose, velocity, segments.dt)
        action = segments.action.repeat(sets, 1, 1)

        def act(row: int, state: TensorDictBase) -> TensorDictBase:
            _impose(state, pose[:, row], velocity[:, row])
            return state.set(keys.ACTION, action[:, row])

        state = self._reset(env, stack, segments, pose[:, 0], velocity[:, 0])
        states = trajectory(env, state, act, action.shape[1] - 1)
        for row, (_, after) in enumerate(pairwise(states)):
            if row >= segments.start:
                both = slice(row, row + 2)
                imposed = torch.cat([pose[:, both], velocity[:, both]], -1).movedim(1, 0)
                yield row, imposed.cpu(), _motion(after).cpu()

    def linear_steps(
        self, segments: Segments, settings: ParameterSets = AS_GIVEN
    ) -> Iterator[LinearStep]:
        """A rollout's steps with their derivatives by the velocity, latent states left as they are.

        Beside each segment roll three copies of it that take its whole state before every step, one
        component of the velocity moved by `OFF`.

        Args:
            segments: N of them.
            settings: One parameter set.
        """
        count, copies = len(segments), 1 + len(OFF)
        settings = settings.map(lambda v: v.expand(copies, *v.shape[1:]))
        env, stack = self._environment(settings, count)
        segments = segments.to(_device(env))
        told = _told(segments, stack, copies)
        pose, velocity = _start(segments, stack, copies)
        action = _commands(segments, settings.clock_offset)
        moved = torch.diag(torch.tensor(OFF, device=velocity.device)).repeat_interleave(count, 0)

        def act(row: int, state: TensorDictBase) -> TensorDictBase:
            if row <= segments.start:
                _impose(state, pose[:, row], velocity[:, row], row <= told)
            if row >= segments.start:
                state = TensorDict.cat([state[:count]] * copies)  # type: ignore[assignment]
                state[keys.VELOCITY][count:] += moved.to(state[keys.VELOCITY].dtype)
            return state.set(keys.ACTION, action[:, row])

        state = self._reset(env, stack, segments, pose[:, 0], velocity[:, 0])
        states = trajectory(env, state, act, action.shape[1] - 1)
        before = pose.new_empty(0)
        for row, after in enumerate(states):
            if row == segments.start:
                before = torch.cat([pose[:count, row], velocity[:count, row]], -1)
                known = (told[:count] == row).unsqueeze(-1)
                before = torch.where(known, before.float(), _motion(after)[:count]).cpu()
            if row > segments.start:
                motion = _motion(after).cpu().view(copies, count, 6)
                own, beside = motion[0], motion[1:, :, 3:]
                slope = (beside - own[:, 3:]).movedim(0, -1) / torch.tensor(OFF)
                both = torch.stack([before, own])
                read = sensed(after)[:count].cpu()
                yield LinearStep(both[..., :3], both[..., 3:], slope, read)
                before = own
        self.rolled(copies * count, action.shape[1] - 1)

    def drive(
        self, actions: Tensor, settings: ParameterSets, start: TensorDictBase
    ) -> Iterator[TensorDictBase]:
        """Yields the states [B] of B environments under actions [B, T, 2], T of them.

        Args:
            actions: Commands.
            settings: C parameter sets, each of B / C environments that follow one another.
            start: `pose` and `velocity` [B, 3].
        """
        env, _ = self._environment(settings, len(actions) // len(settings))
        device = _device(env)
        actions = actions.to(device=device)
        states = trajectory(
            env,
            reset_at(env, start if device is None else start.to(device)),
            lambda row, state: state.set(keys.ACTION, actions[:, row]),
            actions.shape[1] - 1,
        )
        for state in states:
            yield state.cpu()

    def _environment(self, settings: ParameterSets, count: int):
        """One environment for each set and segment."""
        each = settings.map(lambda v: _each(v, count))
        simulator = self.make(len(settings) * count)
        env, stack = augmented(
            simulator, each.effects, each.parameters, self.standing, self.options
        )
        if isinstance(env.base_env, Engine):
            env.base_env.lost_as_nan = True  # one bad trial of many: it counts as far away
        return env, stack

    def _reset(self, env, stack, segments: Segments, pose: Tensor, velocity: Tensor):
        """State at row 0, latent states of effects as the commands before it left them."""
        sets = len(pose) // len(segments)
        given = TensorDict(
            {keys.POSE: pose, keys.VELOCITY: velocity}, [len(pose)], device=env.device
        )
        state = env.reset(given) if isinstance(env, BareEnv) else reset_at(env, given)
        if keys.ELAPSED in state.keys():  # noqa: SIM118  TensorDict has no `in`
            state[keys.ELAPSED] = segments.session.repeat(sets).unsqueeze(-1)
        for effect in stack:
            if isinstance(effect, ThermalFoldback) and effect.active:
                worked = segments.worked.repeat(sets, 1)
                state[effect.memory] = effect.warmed(state[effect.memory], worked, WORKED)
            if isinstance(effect, RememberingCommand) and effect.lasting and effect.active:
                given = segments.earlier[..., effect.channel].repeat(sets, 1)
                state[effect.memory] = effect.remembered(state[effect.memory], given)
        return state


def along_heading(difference: Tensor, segments: Segments) -> Tensor:
    """Differences [*, N, K, 6] of readings, positions along and across the heading at the start."""
    heading = segments.smooth_pose[:, segments.start, 2].unsqueeze(-1)
    position = rotate(difference[..., :2], -heading.expand(difference.shape[:-1]))
    return torch.cat([position, difference[..., 2:]], -1)


def _device(env) -> torch.device | None:
    """The device of an environment; None where it does not say, which is the CPU."""
    return env.device


def _counted(
    function: Callable[..., Result], simulation: Simulation, *task: Any
) -> tuple[Result, list[tuple[int, int]]]:
    """The result, and environments and steps of each rollout that it took."""
    rolled: list[tuple[int, int]] = []
    told = replace(simulation, rolled=lambda cars, steps: rolled.append((cars, steps)))
    return function(told, *task), rolled


def _part(
    settings: ParameterSets, start_error: Tensor | None, rows: slice
) -> tuple[ParameterSets, Tensor | None]:
    return settings.map(lambda v: v[rows]), None if start_error is None else start_error[rows]


def sensed(state: TensorDictBase) -> Tensor:
    """What the sensor shows of a state: pose and velocity [*, 6], float32."""
    pose = state.get(keys.MEASURED_POSE, None)
    velocity = state.get(keys.MEASURED_VELOCITY, None)
    pose = state[keys.POSE] if pose is None else pose
    velocity = state[keys.VELOCITY] if velocity is None else velocity
    return torch.cat([pose, velocity], -1).float()


def _motion(state: TensorDictBase) -> Tensor:
    """True pose and velocity [*, 6], float32."""
    return torch.cat([state[keys.POSE], state[keys.VELOCITY]], -1).float()


def _impose(
    state: TensorDictBase, pose: Tensor, velocity: Tensor, where: Tensor | None = None
) -> None:
    """Sets the motion, in the precision of the simulator; in some environments alone."""
    for key, given in ((keys.POSE, pose), (keys.VELOCITY, velocity)):
        own = given.to(state[key].dtype)
        state[key] = own if where is None else torch.where(where.unsqueeze(-1), own, state[key])


def _each(values: Tensor, count: int) -> Tensor:
    """Values [C] or [C, N] for each environment [C * N]."""
    return values.repeat_interleave(count) if values.dim() == 1 else values.flatten()


def _told(segments: Segments, stack: Sequence[Effect], sets: int) -> Tensor:
    """Last row [C * N] of which the sensor has told the motion by the start: it may be late.

    From there on the motion is the simulator's. Were it imposed until the start, a rollout with a
    late sensor would begin from what was measured after its start, and gain by that alone.
    """
    rows = torch.zeros(sets * len(segments), dtype=torch.long, device=segments.pose.device)
    for effect in stack:
        rows = rows + effect.rows_late(segments.dt).to(rows.device)
    return (segments.start - rows).clamp_min(0)


def _start(
    segments: Segments,
    stack: Sequence[Effect],
    sets: int,
    error: Tensor | None = None,
    told: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """True pose and velocity [C * N, start + 1, 3] that the measurements show, by set.

    Args:
        segments: N of them.
        stack: Effects, from the engine outwards.
        sets: C.
        error: [C, 6] of the last row that is imposed.
        told: [C * N] that row; None for the start.
    """
    first = segments.start + 1
    rows = slice(0, first + round(LATEST / segments.dt))
    pose = segments.smooth_pose[:, rows].repeat(sets, 1, 1)
    velocity = segments.smooth_velocity[:, rows].repeat(sets, 1, 1)
    for effect in reversed(stack):
        pose, velocity = effect.unsensed(pose, velocity, segments.dt)
    pose, velocity = pose[:, :first].clone(), velocity[:, :first].clone()
    if error is not None:
        each = error.to(pose.device).repeat_interleave(len(segments), 0)  # (C * N, 6)
        own = torch.arange(len(pose), device=pose.device)
        last = torch.full_like(own, first - 1) if told is None else told
        pose[own, last, :2] += rotate(each[:, :2], pose[own, last, 2])
        pose[own, last, 2] += each[:, 2]
        velocity[own, last] += each[:, 3:]
    return pose, velocity


def _commands(segments: Segments, offset: Tensor) -> Tensor:
    """Commands [C * N, L, 2] as they act, `offset` [C] or [C, N] s later than stamped."""
    action = segments.action.repeat(len(offset), 1, 1)
    if not bool(offset.any()):
        return action
    length = action.shape[1]
    late = _each(offset, len(segments)).to(action.device) / segments.dt  # (C * N,) rows
    index = torch.arange(length, device=action.device)
    row = (index - late.unsqueeze(-1)).clamp(0, length - 1)  # (C * N, L)
    before = row.floor().long().clamp_max(length - 2)
    older, newer = (
        action.gather(1, index.unsqueeze(-1).expand(-1, -1, 2)) for index in (before, before + 1)
    )
    return torch.lerp(older, newer, (row - before).unsqueeze(-1))
