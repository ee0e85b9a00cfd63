"""Terms as transforms: one class a kind, each row of a batch with a term of its own.

A term alone (`term.yaw.throttle`) is a bank of one member. A bank of all members (`terms.motion.0`)
holds a different term in each environment, so that one rollout screens hundreds of them at the cost
of one effect.
"""

import math
from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.data.utils import DEVICE_TYPING

from buggy_rl.core import keys
from buggy_rl.core.longitudinal import drive_of
from buggy_rl.core.vehicle import planar_norm, rotate
from buggy_rl.effects.actuation.command import FARTHEST, GIVEN
from buggy_rl.effects.base import Effect, EffectParameter, numbers_spec
from buggy_rl.effects.motion.base import Motion, MotionEffect
from buggy_rl.effects.motion.yaw import SLOWEST, tyre_damping
from buggy_rl.effects.sensing.base import SensingEffect, sensed_motion
from buggy_rl.effects.terms.grammar import BANK, LAG, PLACES, PREFIX, Kind, Term, terms_of

STATE = 4  # lagged shape, drive and steering of the step before, whether they are known
SHAPES_OF: dict[str, Any] = {
    "linear": lambda s, bend: s,
    "even": lambda s, bend: s.abs(),
    "odd_square": lambda s, bend: s * s.abs(),
    "even_square": lambda s, bend: s.square(),
    "saturating": lambda s, bend: torch.tanh(s / bend),
    "threshold": lambda s, bend: torch.sign(s) * (s.abs() - bend).clamp_min(0.0),
    "cos": lambda s, bend: torch.cos(s),
    "sin": lambda s, bend: torch.sin(s),
    "cos2": lambda s, bend: torch.cos(2 * s),
    "sin2": lambda s, bend: torch.sin(2 * s),
}
RATES = ("steering_rate", "throttle_rate")
Signals = Mapping[str, Callable[[], Tensor]]
"""What gives each signal [n]: only those that a member has are computed."""


class Bank(Effect):
    """coefficient * shape(signal) of one of its members, in each environment."""

    members: ClassVar[tuple[Term, ...]]
    needs_time: ClassVar[bool]
    """Whether a member depends on the time."""
    needs_past: ClassVar[bool]
    """Whether a member depends on what was before."""
    source = (
        "Brunton, Proctor & Kutz 2016, PNAS 113(15), 3932 (a dictionary of candidate functions, "
        "each linear in its coefficient)"
    )
    deciding = ("coefficient",)

    @classmethod
    def sentence(cls, values: Mapping[str, float]) -> str:
        return cls.members[int(values.get("member", 0))].sentence(values["coefficient"])

    def _values_changed(self) -> None:
        """Looks up the tables of the members that the active rows have."""
        numbers, own = self._member.unique(return_inverse=True)
        used = [self.members[number] for number in numbers.tolist()]
        names = sorted({n for t in used for n in t.signals})
        shapes = sorted({t.shape for t in used})
        self._signal_names, self._shape_names = names, shapes
        self._lagging = any(t.memory == "lag" for t in used)
        first = torch.tensor([names.index(t.signals[0]) for t in used])
        second = torch.tensor(
            [names.index(t.signals[1]) if len(t.signals) > 1 else -1 for t in used]
        )
        shape = torch.tensor([shapes.index(t.shape) for t in used])
        bend = torch.tensor([t.bend for t in used])
        late = torch.tensor([t.memory == "lag" for t in used])
        place = torch.tensor([list(PLACES).index(t.place) for t in used])
        largest = torch.tensor([PLACES[t.place].largest for t in used])
        self._store(
            first=first[own],
            second=second[own],
            shape_index=shape[own],
            bend=bend[own],
            late=late[own],
            largest=largest[own],
            **{f"at_{p}": (place == i).float()[own] for i, p in enumerate(PLACES)},
        )

    @property
    def _member(self) -> Tensor:
        """Index of the member [n] of each active row, or () of all."""
        if len(self.members) == 1:
            return torch.zeros((), dtype=torch.long)
        return self._value("member").round().long().cpu()

    def _shaped(self, signals: Signals) -> Tensor:
        """Shape of the own signal [n] of each active row, before the lag."""
        if len(self.members) == 1:
            (term,) = self.members
            product = signals[term.signals[0]]()
            for name in term.signals[1:]:
                product = product * signals[name]()
            return SHAPES_OF[term.shape](product, term.bend)
        columns = torch.stack([signals[name]() for name in self._signal_names], -1)  # (n, S)
        first, second = self._tensor("first"), self._tensor("second")
        product = _own(columns, first)
        product = torch.where(second < 0, product, product * _own(columns, second.clamp_min(0)))
        bend = self._tensor("bend").to(product.dtype)
        every = [SHAPES_OF[name](product, bend) for name in self._shape_names]
        return _own(torch.stack(every, -1), self._tensor("shape_index"))

    def _late(self, shaped: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """What acts [n], and the lagged shape [n] after the step."""
        if not self._lagging:
            return shaped, shaped
        before = torch.where(state[..., 3] > 0.5, state[..., 0], shaped)
        lagged = before - math.expm1(-self.dt / LAG) * (shaped - before)
        return torch.where(self._tensor("late"), lagged, shaped), lagged

    def _placed(self, shaped: Tensor, places: tuple[str, ...]) -> list[Tensor]:
        """What is added [n], within its bounds, in the column of its own place; 0 in the others."""
        largest = self._tensor("largest").to(shaped.dtype)
        amount = (self._value("coefficient") * shaped).clamp(-largest, largest)
        return [amount * self._tensor(f"at_{place}").to(amount.dtype) for place in places]

    def _rates(self, drive: Tensor, steering: Tensor, state: Tensor) -> Signals:
        def of(now: Tensor, column: int) -> Tensor:
            known = state[..., 3] > 0.5
            return torch.where(known, (now - state[..., column]) / self.dt, torch.zeros_like(now))

        return {"throttle_rate": lambda: of(drive, 1), "steering_rate": lambda: of(steering, 2)}


def _own(columns: Tensor, index: Tensor) -> Tensor:
    """Column `index` [n] or () of columns [n, S]."""
    index = index.expand(columns.shape[:-1])
    return columns.gather(-1, index.unsqueeze(-1)).squeeze(-1)


def _of_motion(pose: Tensor, velocity: Tensor) -> Signals:
    vx, vy, r = velocity.unbind(-1)
    return {
        "one": lambda: torch.ones_like(vx),
        "speed": lambda: planar_norm(vx, vy),
        "lateral_acceleration": lambda: vx * r,
        "yaw_rate": lambda: r,
        "x": lambda: pose[..., 0],
        "y": lambda: pose[..., 1],
        "heading": lambda: pose[..., 2],
    }


class TimedBank(Bank):
    """A bank that keeps time, commands of the step before, and a lag, where members need it."""

    def _memory_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        specs: dict[str, TensorSpec] = {}
        if self.needs_past:
            specs[self.memory] = numbers_spec(shape, STATE, device=device)
        if self.needs_time:
            specs[keys.ELAPSED] = numbers_spec(shape, 1, device=device)
        return specs

    def _state_specs(
        self, shape: torch.Size, device: DEVICE_TYPING | None
    ) -> dict[str, TensorSpec]:
        return self._memory_specs(shape, device)

    def _begin(self, given: TensorDictBase, state: TensorDictBase) -> None:
        velocity = state.get(keys.VELOCITY)
        if self.needs_past:
            state.set(self.memory, velocity.new_zeros(*velocity.shape[:-1], STATE))
        if self.needs_time:
            elapsed = given.get(keys.ELAPSED, None)
            elapsed = torch.zeros_like(velocity[..., :1]) if elapsed is None else elapsed
            state.set(keys.ELAPSED, elapsed.to(velocity).clone())

    def _past(self, tensordict: TensorDictBase, like: Tensor) -> Tensor:
        """State [n, 4] of the active rows; unknown where no member needs it."""
        if self.needs_past:
            return self._gather(tensordict.get(self.memory))
        return like.new_zeros(*like.shape, STATE)

    def _commands(self, drive: Tensor, steering: Tensor, state: Tensor, now: Any) -> Signals:
        """Signals of commands [n], of `state`, and of the time of `now`."""
        return {
            **{"steering": lambda: steering, "throttle": lambda: drive},
            **self._rates(drive, steering, state),
            "time": lambda: self._gather(now.get(keys.ELAPSED)).squeeze(-1),
        }


class MotionTerms(TimedBank, MotionEffect):
    """Accelerations of the centre of gravity; of a yaw moment, what the tyres leave of it."""

    kind = "motion"
    option_names = ("stiffness",)
    stiffness: tuple[float, float] = (0.0, 0.0)
    """Stiffness of front and rear axle over their load [1/rad]; 0 for a simulator without tyres."""

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        self._begin(given, state)

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        self._before, self._after = before, after
        MotionEffect._write_step(self, before, after)
        del self._before, self._after
        if self.needs_time:
            after.set(keys.ELAPSED, before.get(keys.ELAPSED) + self.dt)

    def _change(self, motion: Motion) -> Tensor:
        before, after = self._before, self._after
        drive = drive_of(self._gather(before.get(keys.ACTION)[..., 0], 0).clamp(-1, 1), self.rest)
        steering = motion.action[..., 1]
        state = self._past(before, steering)
        signals = {
            **_of_motion(motion.pose, motion.after),
            "lateral_acceleration": lambda: motion.acceleration[1],
            **self._commands(drive, steering, state, before),
        }
        acting, lagged = self._late(self._shaped(signals), state)
        if self.needs_past:
            memory = before.get(self.memory)
            now = torch.stack([lagged, drive, steering, torch.ones_like(drive)], -1)
            after.set(self.memory, self._scatter(memory, now))
        forward, side, yaw = self._placed(acting, ("forward", "side", "yaw"))
        speed = motion.after[..., 0].abs().clamp_min(SLOWEST)
        damping = tyre_damping(self.dimensions, self.stiffness) / speed
        added = torch.stack([forward, side, yaw / (1 + 0.5 * self.dt * damping)], -1)
        return added * (motion.setting_off * self.dt).unsqueeze(-1)


class CommandTerms(TimedBank):
    """Additions to throttle and steering commands, from the motion before the step."""

    kind = "actuation"

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        if not self.active:
            return tensordict
        action, beyond = tensordict.get(keys.ACTION), tensordict.get(keys.BEYOND, None)
        command = self._gather(action).clamp(-1.0, 1.0)
        drive, steering = drive_of(command[..., 0], self.rest), command[..., 1]
        state = self._past(tensordict, steering)
        pose, velocity = (self._gather(tensordict.get(k)) for k in (keys.POSE, keys.VELOCITY))
        signals = {
            **_of_motion(pose.to(command), velocity.to(command)),
            **self._commands(drive, steering, state, tensordict),
        }
        acting, lagged = self._late(self._shaped(signals), state)
        throttle, steer = self._placed(acting, ("throttle", "steering"))
        scale = 1.0 - self.rest  # the drive command is 0..1 between rest and full
        full = command if beyond is None else command + self._gather(beyond)
        full = full + torch.stack([scale * throttle, steer], -1)
        within = full.clamp(-1.0, 1.0)
        past = full.clamp(-FARTHEST, FARTHEST) - within
        old = torch.zeros_like(action) if beyond is None else beyond
        tensordict.set(keys.BEYOND, self._scatter(old, past))
        tensordict.set(keys.ACTION, self._scatter(action, within))
        if self.needs_past:
            memory = tensordict.get(self.memory)
            now = torch.stack([lagged, drive, steering, torch.ones_like(drive)], -1)
            tensordict.set(self.memory + GIVEN, self._scatter(memory, now))
        return tensordict

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        self._begin(given, state)

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        if self.needs_past:
            after.set(self.memory, before.get(self.memory + GIVEN))
        if self.needs_time:
            after.set(keys.ELAPSED, before.get(keys.ELAPSED) + self.dt)


SHOWN = ("shown_vx", "shown_vy", "shown_yaw_rate", "shown_ahead", "shown_left", "shown_heading")


class SensorTerms(Bank, SensingEffect):
    """Additions to what a sensor shows, from the motion that it measures."""

    kind = "sensing"

    def _write_reset(self, given: TensorDictBase, state: TensorDictBase) -> None:
        self._write_step(given, state)

    def _write_step(self, before: TensorDictBase, after: TensorDictBase) -> None:
        pose, velocity = sensed_motion(after)
        rows = self._shown(self._gather(pose), self._gather(velocity), 1.0)
        self._set_measured(after, (pose, velocity), rows)

    def _true_motion(self, pose: Tensor, velocity: Tensor, dt: float) -> tuple[Tensor, Tensor]:
        rows = self._shown(pose.movedim(-2, 0), velocity.movedim(-2, 0), -1.0)
        return rows[0].movedim(0, -2), rows[1].movedim(0, -2)

    def _shown(self, pose: Tensor, velocity: Tensor, sign: float) -> tuple[Tensor, Tensor]:
        """Pose and velocity [..., n, 3] with the addition, or without it again where -1."""
        shaped = sign * self._shaped(_of_motion(pose, velocity))
        vx, vy, r, ahead, left, heading = self._placed(shaped, SHOWN)
        way = rotate(torch.stack([ahead, left], -1), pose[..., 2])
        shown = torch.cat([pose[..., :2] + way, (pose[..., 2] + heading).unsqueeze(-1)], -1)
        return shown, velocity + torch.stack([vx, vy, r], -1)


CLASSES: dict[Kind, type[Bank]] = {
    "actuation": CommandTerms,
    "motion": MotionTerms,
    "sensing": SensorTerms,
}


@cache
def term_class(name: str) -> type[Bank]:
    """The class of a term by its name, or of a bank (`terms.motion.0`).

    Raises:
        ValueError: The grammar has no such term.
    """
    if name.startswith(BANK):
        kinds: list[Kind] = [k for k in CLASSES if name.startswith(BANK + k)]
        if not kinds:
            raise ValueError(f"no bank of terms {name!r}")
        [kind] = kinds
        members = terms_of(kind)
        chosen = EffectParameter(
            "member", 0.0, 0.0, float(len(members) - 1), "-", "Which term.", size=1.0, probe=1.0
        )
        declared = (chosen, EffectParameter("coefficient", 0.0, -1e6, 1e6, "-", "", 1.0, 0.1))
        equation = "+ coefficient shape(signal), of any member"
    else:
        term = Term.parse(name)
        members, kind = (term,), PLACES[term.place].kind
        declared = (
            EffectParameter(
                "coefficient",
                0.0,
                -term.bound,
                term.bound,
                term.unit,
                f"Of {term.equation}.",
                size=term.size,
                probe=0.1 * term.size,
            ),
        )
        equation = term.equation
    return type(
        name,
        (CLASSES[kind],),
        {
            "__module__": __name__,
            "__qualname__": name.replace(".", "__"),  # a dot would be an attribute of it
            "__doc__": f"{equation}",
            "name": name,
            "members": members,
            "needs_time": any("time" in t.signals for t in members),
            "needs_past": any(t.memory == "lag" or {*t.signals} & {*RATES} for t in members),
            "declared": declared,
            "equation": equation,
        },
    )


def __getattr__(name: str) -> Any:
    """Classes of terms by name, so that instances can be pickled."""
    dotted = name.replace("__", ".")
    if dotted.startswith((PREFIX, BANK)):
        return term_class(dotted)
    raise AttributeError(name)
