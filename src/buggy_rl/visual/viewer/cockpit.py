"""What a driver sits in: the control page, the 3D view and the input, or a scripted driver."""

import time
from collections.abc import Callable

from torchrl.envs import EnvBase

from buggy_rl.car.human import HumanInput
from buggy_rl.car.joystick import JoystickInput
from buggy_rl.core.longitudinal import LongitudinalCommand
from buggy_rl.policies.controllers.at_scale import taken_by
from buggy_rl.policies.controllers.path_tracking import PurePursuit
from buggy_rl.policies.human_table import DriveNote
from buggy_rl.policies.people import DriveConfig, Input, LiveStep, ScriptedInput
from buggy_rl.visual.film.source import course_of, label
from buggy_rl.visual.viewer.control_page import ControlPage
from buggy_rl.visual.viewer.live_window import LiveWindow

FRAME = 3  # steps of 10 ms between two rows that are shown
LINGER = 1.0  # [s] for which the page still hears the result


class Cockpit:
    """Everything about a drive that is not the simulator: who drives, and what they see.

    Args:
        config: Of the drive.
        env: That is driven; its path is shown.

    Raises:
        ValueError: The port is taken, there is no joystick, or its commands would reverse a car
            that it means to stop.
    """

    def __init__(self, config: DriveConfig, env: EnvBase) -> None:
        self._config, self._command = config, taken_by(env)
        _refuse_another_rest(config, self._command)
        self._human = HumanInput(config.human)
        self.input: Input = self._chosen()
        self._window: LiveWindow | None = None
        self._page: ControlPage | None = None
        if config.view:
            self._window = LiveWindow(label(config.simulator), course_of(env), config.camera)
            scene, look = self._window.url, self._window.look
            self._page = ControlPage(self._human, scene, config.port, look)

    def __enter__(self) -> "Cockpit":
        """The cockpit itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Ends page and view."""
        for part in (self._page, self._window):
            if part is not None:
                part.close()

    def wait_for_start(self, say: Callable[[str], None]) -> None:
        """Says the address, waits for a person, and counts down; a scripted driver starts."""
        if self._page is not None:
            say(f"the drive is at {self._page.url} (on this machine only)")
        if self._config.in_browser and self._page is not None:
            say("open it and press Enter there; Ctrl-C ends")
            while not self._page.started.wait(0.2):
                pass  # short waits, so that Ctrl-C is heard
        if self._config.driver != "scripted":
            self._count_down()

    def show(self, row: LiveStep) -> None:
        """Shows a step, if it is its turn."""
        if self._page is None or self._window is None or round(100 * row.time) % FRAME:
            return
        self._window.show((row.time, row.values, row.following))
        _, _, _, vx, _, _, throttle, steering = row.values
        self._page.tell(
            phase="driving",
            time=row.time,
            waypoints=row.waypoints,
            speed=vx,
            throttle=throttle,
            steering=steering,
            silent=self._config.in_browser and self._human.silent,
        )

    def end(self, note: DriveNote) -> None:
        """Shows the result."""
        if self._page is not None:
            self._page.tell(phase="ended", time=note.seconds, waypoints=note.waypoints)
            time.sleep(LINGER)

    def _chosen(self) -> Input:
        if self._config.driver == "scripted":
            return ScriptedInput(PurePursuit(command=self._command))
        return (
            JoystickInput(self._config.human) if self._config.driver == "joystick" else self._human
        )

    def _count_down(self) -> None:
        begin = time.monotonic()
        while (left := self._config.countdown - (time.monotonic() - begin)) > 0:
            if self._page is not None:
                self._page.tell(phase="countdown", left=left)
            time.sleep(min(left, 0.05))


def _refuse_another_rest(config: DriveConfig, command: LongitudinalCommand) -> None:
    if config.driver != "scripted" and config.human.two_way != command.two_way:
        raise ValueError(
            f"simulator {config.simulator} takes the command {command}, which is at rest at "
            f"{command.rest:g}: set human.two_way={str(command.two_way).lower()}"
            + (" and human.top_throttle above 0" if command.two_way else "")
        )
