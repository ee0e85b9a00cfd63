"""A person's keys and sticks -> commands; neutral as soon as nothing is heard.

The same driver in the viewer and on the car.
"""

import json
import math
import threading
import time
from typing import Any, Callable, Mapping, NamedTuple, Optional, Union

from buggy_rl.car.interfaces import NO_DRIVE, Command, Pilot, neutral_of
from buggy_rl.car.settings import section


class HumanConfig(NamedTuple):
    """How keys and sticks become commands; `policies.human.HumanConfig` is the command line's."""

    silence: float = 0.08
    """Time without a message after which the command is neutral [s]; a step later it is applied."""
    top_throttle: float = 0.0
    """Throttle that the forward key goes to, in (-1, 1]; 0 is half of the drive."""
    throttle_rise: float = 1.0
    """Rate of the forward key [1/s]; from no drive to half takes 1 s."""
    throttle_fall: float = 4.0
    """Rate after the forward key was released [1/s]."""
    lock: float = 1.0
    """Steering that a steering key goes to, in (0, 1]."""
    steering_rise: float = 4.0
    """Rate of a steering key [1/s]."""
    steering_fall: float = 8.0
    """Rate back towards the middle [1/s]."""
    dead_zone: float = 0.08
    """Dead zone of a stick about its middle."""
    two_way: bool = False
    """Whether the car brakes and reverses: no drive is throttle 0, not -1."""


def check_human(config: Any) -> None:
    """Checks the numbers of a `HumanConfig`.

    Raises:
        ValueError: One could not drive a car; the message names it.
    """
    for name in ("throttle_rise", "throttle_fall", "steering_rise", "steering_fall"):
        if not getattr(config, name) > 0:
            raise ValueError(f"human.{name}={getattr(config, name):g}: must be above 0")
    if not 0 < config.silence <= 0.09:
        raise ValueError(
            f"human.silence={config.silence:g} s: must be above 0 and at most 0.09, so that the "
            "car has no drive 0.1 s after the browser went away"
        )
    lowest = neutral_of(config.two_way)[0]
    if not lowest < config.top_throttle <= 1:
        raise ValueError(
            f"human.top_throttle={config.top_throttle:g}: must be in ({lowest:g}, 1]"
            + (", where two_way is true" if config.two_way else "")
        )
    if not 0 < config.lock <= 1:
        raise ValueError(f"human.lock={config.lock:g}: must be in (0, 1]")
    if not 0 <= config.dead_zone < 1:
        raise ValueError(f"human.dead_zone={config.dead_zone:g}: must be in [0, 1)")


class Controls(NamedTuple):
    """What is held at an instant."""

    source: str = "keyboard"
    """keyboard, whose keys are ramped, or gamepad, whose sticks are taken as they are."""
    throttle: float = NO_DRIVE
    """Command of a gamepad; of a keyboard 1 while the forward key is held, else -1."""
    steering: float = 0.0
    """Command of a gamepad; of a keyboard 1 to the left, -1 to the right, 0 for neither."""
    neutral: bool = False
    """The neutral key: at once, without a ramp."""
    reverse: bool = False
    """The brake key, of a car that brakes and reverses."""
    connected: bool = True
    """False when the page is left or the gamepad is unplugged."""


def read_controls(message: Union[str, bytes]) -> Controls:
    """The controls in a JSON object such as `{"throttle": 1, "steering": 0, "connected": true}`.

    Raises:
        ValueError: It is no such object, or a number is not in [-1, 1].
    """
    content = json.loads(message)
    known = Controls._fields
    if not isinstance(content, dict) or not content.keys() <= set(known):
        names = ", ".join(known)
        raise ValueError(f"controls {message!r}: must be an object with some of {names}")
    controls = Controls(**content)
    if controls.source not in ("keyboard", "gamepad"):
        raise ValueError(f"controls source={controls.source!r}: must be keyboard or gamepad")
    for name in ("throttle", "steering"):
        value = getattr(controls, name)
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not abs(value) <= 1:
            raise ValueError(f"controls {name}={value!r}: must be a number in [-1, 1]")
    for name in ("neutral", "reverse", "connected"):
        if not isinstance(getattr(controls, name), bool):
            raise ValueError(f"controls {name}={getattr(controls, name)!r}: must be true or false")
    return controls


class HumanInput:
    """Commands of the controls last heard; neutral before the first and after a silence.

    A thread may write while another reads.

    Args:
        config: Ramps and the longest silence: a `HumanConfig`, this one or the command line's.
        clock: Monotonic time [s].
    """

    def __init__(self, config: Any = None, clock: Callable[[], float] = time.monotonic) -> None:
        self.config = HumanConfig() if config is None else config
        check_human(self.config)
        self._clock, self._at_rest = clock, neutral_of(self.config.two_way)
        self._lock = threading.Lock()
        self._heard = -math.inf
        self._controls = Controls()
        self._now: Command = self._at_rest

    def hear(self, controls: Controls) -> None:
        """Takes what is held now."""
        with self._lock:
            self._controls, self._heard = controls, self._clock()

    @property
    def silent(self) -> bool:
        """Nobody is there: nothing was heard, the last message is too old or said goodbye."""
        with self._lock:
            late = self._clock() - self._heard > self.config.silence
            return late or not self._controls.connected

    def command(self, dt: float) -> Command:
        """The command for the step that begins now and lasts `dt` [s]."""
        silent, controls = self.silent, self._controls
        if silent or controls.neutral:
            self._now = self._at_rest
        elif controls.source == "gamepad":
            steering = without_dead_zone(controls.steering, self.config.dead_zone)
            throttle = controls.throttle
            if self.config.two_way:  # a trigger, from -1 where it is let go
                throttle = 0.5 * (throttle + 1) * (-1 if controls.reverse else 1)
            elif controls.reverse:
                throttle = NO_DRIVE
            self._now = throttle, steering
        else:
            self._now = self._ramped(controls, dt)
        return self._now

    def _ramped(self, controls: Controls, dt: float) -> Command:
        c, (throttle, steering) = self.config, self._now
        rest = self._at_rest[0]
        top = c.top_throttle if controls.throttle > 0 else rest
        if c.two_way and controls.reverse:
            top = -c.top_throttle
        # A brake is let go as fast as the drive is.
        rise = c.throttle_rise if throttle >= rest else c.throttle_fall
        throttle = toward(throttle, top, dt * rise, dt * c.throttle_fall)
        side = c.lock * controls.steering
        # On the way back to the middle, the wheels turn faster than away from it.
        fall = min(abs(steering), dt * c.steering_fall) if steering * side <= 0 else 0.0
        steering -= math.copysign(fall, steering)
        rate = c.steering_rise if side else c.steering_fall
        return throttle, toward(steering, side, dt * rate, dt * rate)


def toward(value: float, target: float, rise: float, fall: float) -> float:
    """`value` on its way to `target`, by at most `rise` upwards or `fall` downwards."""
    return min(value + rise, target) if target >= value else max(value - fall, target)


def without_dead_zone(value: float, dead_zone: float) -> float:
    """A stick's value in [-1, 1] that is 0 within the dead zone and continuous at its edge."""
    beyond = max(0.0, abs(value) - dead_zone) / (1 - dead_zone)
    return math.copysign(beyond, value)


LONGEST_PRESS = 0.2  # [s] in which the button arms if it does


class Schedule(NamedTuple):
    """Times at which the button is pressed."""

    press_after: float = 0.5
    """Time from the start, and from each disarming, until the button is pressed [s]."""
    again: bool = False
    """Arms the car again after it was disarmed; false: once only."""


class ScriptedPilot(Pilot):
    """Leaves the car to the policy and holds the button.

    A press that did not arm for `LONGEST_PRESS` is repeated. After a disarming the button is
    released, and pressed again if the schedule says so.

    Args:
        schedule: When.
    """

    def __init__(self, schedule: Optional[Schedule] = None) -> None:
        self.schedule = schedule or Schedule()
        self._wait = self.schedule.press_after
        self._held, self._armed, self._done = False, False, False
        self._driven = False

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "ScriptedPilot":
        """Makes a pilot from settings: the fields of `Schedule`."""
        return cls(section(Schedule, settings, "pilot", {"press_after": (0.02, 60.0)}))

    def command(self, dt: float) -> Optional[Command]:
        self._wait -= dt
        if self._held and not self._driven and self._wait < -LONGEST_PRESS:
            self._held, self._wait = False, self.schedule.press_after
        elif self._wait <= 0 and not self._done:
            self._held = True
        return None

    @property
    def hold_to_drive(self) -> bool:
        return self._held

    def show(self, armed: bool, message: str) -> None:
        self._driven = armed
        if armed:
            self._armed = True
            return
        self._held, self._wait = False, self.schedule.press_after
        self._done = self._armed and not self.schedule.again
