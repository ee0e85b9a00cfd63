"""A joystick or gamepad plugged into this machine, through pygame where that is installed."""

from buggy_rl.policies.human import NEUTRAL, Command, HumanConfig, without_dead_zone

STEERING_AXIS, THROTTLE_AXIS = 0, 5  # left stick across, right trigger, as SDL counts them


class JoystickInput:
    """Commands of the first joystick: left stick across steers, right trigger drives.

    Neutral while it is unplugged.

    Raises:
        ValueError: pygame is not installed, or no joystick is plugged in.
    """

    def __init__(self, config: HumanConfig | None = None) -> None:
        try:
            import pygame  # pyright: ignore[reportMissingImports]
        except ImportError:
            raise ValueError(
                "driver=joystick needs pygame: pip install pygame, or drive with driver=gamepad in "
                "the browser"
            ) from None
        self.config = config or HumanConfig()
        self._pygame = pygame
        pygame.init()
        pygame.joystick.init()
        if not pygame.joystick.get_count():
            raise ValueError("driver=joystick: no joystick is plugged in; plug one in, start again")
        self._stick = pygame.joystick.Joystick(0)
        self._moved = False  # SDL reports a trigger as 0, half drive, until it first moves

    def command(self, dt: float) -> Command:
        """The command for the step that begins now."""
        del dt
        pygame = self._pygame
        for event in pygame.event.get():
            if event.type == pygame.JOYAXISMOTION and event.axis == THROTTLE_AXIS:
                self._moved = True
            if event.type == pygame.JOYDEVICEREMOVED:
                self._moved = False
        if not pygame.joystick.get_count():
            return NEUTRAL
        side = max(-1.0, min(1.0, -self._stick.get_axis(STEERING_AXIS)))
        throttle = self._stick.get_axis(THROTTLE_AXIS) if self._moved else NEUTRAL[0]
        return max(-1.0, min(1.0, throttle)), without_dead_zone(side, self.config.dead_zone)
