"""Physics that no effect describes, composed of primitives: the answer to such a car is "unknown".

    signal of the drive -> memory -> shape -> times a size -> where it acts

    x = s(pose, velocity, action) / typical;  T dy/dt = x - y (lag, heat), or y follows x with play;
    added = size f(y), f one of x, |x|, x |x|, tanh 3x, sign x max(|x| - 0.4, 0) / 0.6

A `Sort` is one combination. Combinations that an effect of the library has, or nearly has, are left
out (`known`): a push against the speed is drag, whatever its shape.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.vehicle import CONTROL_PERIOD

FORCES = {"forward": 0, "side": 1, "yaw": 2}  # -> column of the velocity
COMMANDS = {"throttle": 0, "steering": 1}  # -> column of the action
SEEN = {  # what the sensor shows -> key and column
    "seen_yaw": (keys.POSE, 2),
    "seen_speed": (keys.VELOCITY, 0),
    "seen_drift": (keys.VELOCITY, 1),
    "seen_yaw_rate": (keys.VELOCITY, 2),
}
WHERE = (*FORCES, *COMMANDS, *SEEN)
SIGNALS = (
    "speed", "lateral", "steering", "throttle", "yaw_rate", "steering_rate", "way", "place", "time"
)  # fmt: skip
SHAPES = ("linear", "even", "square", "saturating", "threshold")
MEMORIES = ("none", "lag", "heat", "play")
TYPICAL = {  # values at which a signal counts as 1: those of brisk driving in a room
    "speed": 2.0,  # [m/s]
    "lateral": 5.0,  # [m/s^2] speed times yaw rate
    "yaw_rate": 3.0,  # [rad/s]
    "steering_rate": 5.0,  # [1/s]
    "time": 30.0,  # [s]
}
ROUND = 2 * math.pi / 0.35  # [rad/m] a signal of the way repeats after 0.35 m; chosen
PLACES = 2 * math.pi / 3.0  # [rad/m] one of the place after 3 m
PLAY = 0.25  # [-] half width of the play of a memory
THRESHOLD = 0.4  # [-]
ALIKE = {  # where it acts -> signals by which the library has it, or something alike
    "forward": ("speed", "throttle", "place", "lateral"),  # drags, drive, slope
    "side": ("place", "steering", "yaw_rate", "lateral"),  # slope, wind, tyres
    "yaw": ("yaw_rate", "speed", "steering", "lateral"),  # damping, one-sided drag, balance
    "throttle": ("throttle", "time", "speed"),  # gain, offset, deadband, lag, sag, limits
    "steering": ("steering", "steering_rate", "yaw_rate"),  # gain, asymmetry, lag, play
    # A sensor's scale, bias, angle, lever arm and lag.
    **dict.fromkeys(
        SEEN, ("speed", "yaw_rate", "lateral", "steering", "steering_rate", "throttle")
    ),
}
SLOWLY_NEW = ("forward", "side", "yaw")  # nothing in the library builds up over time there


@dataclass(frozen=True)
class Sort:
    """One kind of composed physics."""

    where: str
    of: str
    shape: str
    memory: str

    def __post_init__(self) -> None:
        for value, known in (
            (self.where, WHERE), (self.of, SIGNALS), (self.shape, SHAPES), (self.memory, MEMORIES)
        ):  # fmt: skip
            if value not in known:
                raise ValueError(f"no primitive {value!r}; available: {', '.join(known)}")

    def __str__(self) -> str:
        return ".".join((self.where, self.of, self.shape, self.memory))

    @classmethod
    def named(cls, name: str) -> "Sort":
        """The sort of a name such as `yaw.lateral.threshold.lag`.

        Raises:
            ValueError: A part of it is no primitive.
        """
        parts = name.split(".")
        if len(parts) != 4:
            raise ValueError(f"{name!r} is not where.signal.shape.memory")
        return cls(*parts)

    @property
    def known(self) -> bool:
        """Whether the library has it, or what would pass for it."""
        return self.of in ALIKE[self.where] and not (self.slow and self.where in SLOWLY_NEW)

    @property
    def slow(self) -> bool:
        """Whether it builds up over many seconds."""
        return self.memory == "heat"


SORTS = tuple(
    str(sort)
    for sort in (Sort(*parts) for parts in product(WHERE, SIGNALS, SHAPES, MEMORIES))
    # Time only grows, and what repeats has no mean: play, or heat, is another size of it.
    if not sort.known
    and not (sort.of in ("time", "way", "place") and sort.memory in ("play", "heat"))
)


NAMED_SINCE = (  # patterns of sorts that the library has got a name for since the published sets
    ("throttle", "steering", "even", ""),  # brown-out of a servo that holds
    ("throttle", "steering_rate", "even", ""),  # and of one that moves
    ("forward", "throttle", "", "heat"),  # thermal fold-back
    ("steering", "lateral", "saturating", ""),  # play that the tyres take up
    ("forward", "steering", "even", "none"),  # steering drag
    ("forward", "steering", "even", "lag"),
    ("steering", "lateral", "linear", "none"),  # understeer by compliance, roll steer
    ("steering", "lateral", "linear", "lag"),
    ("steering", "lateral", "threshold", "none"),
    ("yaw", "throttle", "linear", "none"),  # torque steer; a drive is never below 0
    ("yaw", "throttle", "linear", "lag"),
    ("yaw", "throttle", "even", "none"),
    ("yaw", "throttle", "even", "lag"),
    ("steering", "throttle", "linear", "none"),  # the same, and dive steer, at the wheels
    ("steering", "throttle", "linear", "lag"),
    ("steering", "throttle", "even", "none"),
    ("steering", "throttle", "even", "lag"),
    ("seen_yaw", "time", "linear", "none"),  # heading drift
    ("seen_yaw", "time", "even", "none"),
)
"""Place where it acts, of what, its shape and memory; an empty part is any."""


def _named_since(name: str) -> bool:
    parts = name.split(".")
    return any(
        all(not wanted or wanted == part for wanted, part in zip(pattern, parts, strict=True))
        for pattern in NAMED_SINCE
    )


UNNAMED = tuple(name for name in SORTS if not _named_since(name))
"""Sorts that the present library has no name for either."""


def is_composed(name: str) -> bool:
    """Whether a name is that of a sort."""
    return name in SORTS


class Disturbance:
    """A sort with its numbers, acting on a batch of cars; what it remembers is its own.

    Args:
        name: Of the sort.
        numbers: `size` in the unit of where it acts (m/s^2, rad/s^2, command, rad, m/s, rad/s),
            `time_constant` [s] of a lag or heat, `phase` [rad] of a way or place.
    """

    def __init__(self, name: str, numbers: Mapping[str, float]) -> None:
        self.sort = Sort.named(name)
        self.numbers = numbers
        self._memory: dict[str, Tensor] = {}

    def acting(self, state: TensorDictBase) -> TensorDictBase:
        """A state [n] with its action, as the car has it: pushed for a period, or commanded."""
        where, action = self.sort.where, state[keys.ACTION]
        if where in SEEN:
            return state
        added = self.added(state[keys.POSE], state[keys.VELOCITY], action)
        if where in COMMANDS:
            changed = action.clone()
            changed[..., COMMANDS[where]] += added.to(action)
            return state.set(keys.ACTION, changed.clamp(-1.0, 1.0))
        velocity = state[keys.VELOCITY].clone()
        velocity[..., FORCES[where]] += (CONTROL_PERIOD * added).to(velocity)
        return state.set(keys.VELOCITY, velocity)

    def seen(self, motion: TensorDictBase) -> TensorDictBase:
        """A motion [T] as the sensor has it, before the noise."""
        if self.sort.where not in SEEN:
            return motion
        self._memory = {}
        key, column = SEEN[self.sort.where]
        columns = [motion[k].unsqueeze(1) for k in (keys.POSE, keys.VELOCITY, keys.ACTION)]
        added = torch.cat([self.added(*row) for row in zip(*columns, strict=True)])
        changed = motion[key].clone()
        changed[:, column] += added.to(changed)
        return TensorDict({**motion, key: changed}, motion.batch_size)

    def added(self, pose: Tensor, velocity: Tensor, action: Tensor) -> Tensor:
        """What is added [n] in this control period; it remembers what was before."""
        # At rest nothing pushes: a force that acts only in motion, as friction does.
        moving = torch.tanh(torch.linalg.vector_norm(velocity[..., :2], dim=-1) / 0.1)
        size = self.numbers["size"]
        shaped = self._shaped(self._remembered(self._signal(pose, velocity, action)))
        return (size * shaped * (moving if self.sort.where in FORCES else 1.0)).float()

    def _signal(self, pose: Tensor, velocity: Tensor, action: Tensor) -> Tensor:
        of, memory, phase = self.sort.of, self._memory, self.numbers.get("phase", 0.0)
        vx, _, yaw_rate = velocity.unbind(-1)
        if of == "steering":
            return action[..., 1]
        if of == "throttle":
            return 0.5 * (action[..., 0] + 1)
        if of == "place":
            return torch.sin(PLACES * pose[..., 0] + phase) * torch.cos(PLACES * pose[..., 1])
        if of == "way":
            memory["way"] = memory.get("way", 0 * vx) + CONTROL_PERIOD * vx
            return torch.sin(ROUND * memory["way"] + phase)
        if of == "time":
            memory["time"] = memory.get("time", 0 * vx) + CONTROL_PERIOD
            value = memory["time"]
        elif of == "steering_rate":
            value = (action[..., 1] - memory.get("steering", action[..., 1])) / CONTROL_PERIOD
            memory["steering"] = action[..., 1].clone()
        else:
            value = {"speed": vx, "lateral": vx * yaw_rate, "yaw_rate": yaw_rate}[of]
        return value / TYPICAL[of]

    def _remembered(self, signal: Tensor) -> Tensor:
        if self.sort.memory == "none":
            return signal
        before = self._memory.get("state", 0 * signal)
        if self.sort.memory == "play":
            now = torch.minimum(torch.maximum(before, signal - PLAY), signal + PLAY)
        else:
            kept = math.exp(-CONTROL_PERIOD / self.numbers["time_constant"])
            # Heat rises with the square, whatever the sign.
            now = (signal if self.sort.memory == "lag" else signal.square()) * (1 - kept)
            now = now + kept * before
        self._memory["state"] = now
        return now

    def _shaped(self, x: Tensor) -> Tensor:
        shape = self.sort.shape
        if shape == "even":
            return x.abs()
        if shape == "square":
            return x * x.abs()
        if shape == "saturating":
            return torch.tanh(3 * x)
        if shape == "threshold":
            return (x.abs() - THRESHOLD).clamp_min(0.0) / (1 - THRESHOLD) * x.sign()
        return x
