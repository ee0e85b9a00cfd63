"""A joystick or gamepad plugged into this machine, through pygame where that is installed.

`JoystickInput` is the viewer's driver, `Joystick` the same one with a button to hold, for the car.
"""

import os
from typing import Any, Mapping, NamedTuple, Optional, Set

from buggy_rl.car.human import HumanConfig, without_dead_zone
from buggy_rl.car.interfaces import NO_DRIVE, Command, Pilot, neutral_of
from buggy_rl.car.settings import section

HEADLESS = {"SDL_VIDEODRIVER": "dummy", "SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS": "1"}
PULLED = 0.1  # of the throttle away from no drive, from which a person takes over from the policy


class PadLayout(NamedTuple):
    """Axes and buttons of the pad, as SDL counts them; the defaults are an Xbox pad's."""

    steering_axis: int = 0
    """Left stick across."""
    throttle_axis: int = 5
    """Right trigger."""
    brake_axis: int = 2
    """Left trigger: brakes and reverses a car that can."""
    hold_button: int = 4
    """Left shoulder: held for the car to drive."""
    dead_zone: float = 0.08
    """Dead zone of the stick about its middle."""
    two_way: bool = False
    """Whether the car brakes and reverses: no drive is throttle 0, not -1; set by `car.two_way`."""


RANGES = {
    "steering_axis": (0, 15),
    "throttle_axis": (0, 15),
    "brake_axis": (0, 15),
    "hold_button": (0, 31),
    "dead_zone": (0.0, 0.5),
}


class JoystickInput:
    """Commands of the first joystick: left stick across steers, right trigger drives.

    Neutral while it is unplugged; plugged in again it is used again.

    Args:
        config: Anything with a `dead_zone` and `two_way`, as `HumanConfig`.
        layout: Axes and buttons.

    Raises:
        ValueError: pygame is not installed, or no joystick is plugged in.
    """

    def __init__(self, config: Any = None, layout: Optional[PadLayout] = None) -> None:
        for name, value in HEADLESS.items():
            os.environ.setdefault(name, value)  # without a screen SDL hears no events otherwise
        try:
            import pygame  # pyright: ignore[reportMissingImports]
        except ImportError:
            raise ValueError(
                "a joystick needs pygame: pip install pygame (in the viewer, driver=gamepad goes "
                "without)"
            ) from None
        self.config, self.layout = config or HumanConfig(), layout or PadLayout()
        self._pygame = pygame
        pygame.init()
        pygame.joystick.init()
        if not pygame.joystick.get_count():
            raise ValueError("no joystick is plugged in: plug one in, start again")
        self._stick = pygame.joystick.Joystick(0)
        self._two_way = bool(self.config.two_way)
        self._at_rest = neutral_of(self._two_way)
        self._moved: Set[int] = set()  # SDL reports a trigger as 0, half drive, until it moves

    def command(self, dt: float) -> Command:
        """The command for the step that begins now."""
        del dt
        if not self.listen():
            return self._at_rest
        layout = self.layout
        side = max(-1.0, min(1.0, -self._stick.get_axis(layout.steering_axis)))
        throttle = self._trigger(layout.throttle_axis)
        if self._two_way:
            throttle = 0.5 * (throttle - self._trigger(layout.brake_axis))
        return max(-1.0, min(1.0, throttle)), without_dead_zone(side, self.config.dead_zone)

    def _trigger(self, axis: int) -> float:
        """-1 where it is let go, 1 where it is pulled."""
        return self._stick.get_axis(axis) if axis in self._moved else NO_DRIVE

    def listen(self) -> bool:
        """Takes what happened since the last call; returns whether a joystick is there."""
        pygame = self._pygame
        for event in pygame.event.get():
            if event.type == pygame.JOYAXISMOTION:
                self._moved.add(event.axis)
            if event.type == pygame.JOYDEVICEREMOVED:
                self._moved.clear()
            if event.type == pygame.JOYDEVICEADDED:
                self._stick = pygame.joystick.Joystick(0)
        return bool(pygame.joystick.get_count())

    @property
    def held(self) -> bool:
        """The button is held, as far as `listen` has heard."""
        there = self._pygame.joystick.get_count()
        return bool(there and self._stick.get_button(self.layout.hold_button))

    def close(self) -> None:
        """Lets go of all joysticks."""
        self._pygame.joystick.quit()


class Joystick(Pilot):
    """A person on the car's joystick: holds the button, and takes over by trigger or stick.

    Args:
        stick: The driver.
    """

    def __init__(self, stick: JoystickInput) -> None:
        self._stick, self._rest = stick, neutral_of(stick.layout.two_way)[0]
        self._closed = False

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "Joystick":
        """Makes a joystick from settings: the fields of `PadLayout`.

        Raises:
            ValueError: A setting is invalid, pygame is not installed, or no joystick is there.
        """
        layout = section(PadLayout, settings, "pilot", RANGES)
        return cls(JoystickInput(layout, layout))

    def command(self, dt: float) -> Optional[Command]:
        throttle, steering = self._stick.command(dt)
        mine = abs(throttle - self._rest) > PULLED or steering != 0.0
        return (throttle, steering) if mine else None

    @property
    def hold_to_drive(self) -> bool:
        return not self._closed and self._stick.held

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._stick.close()
