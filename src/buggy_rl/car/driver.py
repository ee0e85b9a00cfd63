"""What drives where no person does: an exported policy, pure pursuit, or nothing."""

from typing import Any, Mapping, NamedTuple, Optional

from buggy_rl.car.interfaces import Command, Reading
from buggy_rl.car.path import Pursuit, load_path
from buggy_rl.car.policy import Policy
from buggy_rl.car.settings import section


class PlacedPath(NamedTuple):
    """The path, and how it lies."""

    path: str
    """A CSV of waypoints x, y [m]."""
    placed: bool = False
    """The path begins where the car is armed; false: it lies in the tracker's frame."""


class PathDriver:
    """A policy on a path, begun anew at each arming.

    Args:
        policy: With `control_period`, `reset(path)`, `step(pose, velocity)`, `acted(command)` and
            `ended`.
        course: Its path.
    """

    def __init__(self, policy: Any, course: PlacedPath) -> None:
        self.policy, self.course = policy, course
        self._path = load_path(course.path)
        self._begun = False

    def begin(self, reading: Reading) -> None:
        """Begins the path and the policy anew from a reading on."""
        self.policy.reset(self._path.placed(reading.pose) if self.course.placed else self._path)
        self._begun = True

    def step(self, reading: Reading) -> Command:
        """The command for a reading."""
        return self.policy.step(reading.pose, reading.velocity)

    def acted(self, command: Command) -> None:
        """Says what the wheels got where this driver was asked, after limits and people."""
        self.policy.acted(command)

    def refuse_other_than(self, period: float) -> None:
        """Checks the control period [s] of the loop.

        Raises:
            ValueError: The policy has another one.
        """
        own = self.policy.control_period
        if abs(period - own) > 1e-9:
            raise ValueError(
                f"car.period={period:g} s, but the policy was made for {own:g} s: make them equal"
            )

    @property
    def ended(self) -> str:
        """Why it drives no further; empty if it does."""
        return self.policy.ended if self._begun else ""


def make_path_driver(about: Mapping[str, Any], two_way: bool = False) -> Optional[PathDriver]:
    """The driver that the section `policy` of a config names.

    Args:
        about: `kind` is `exported` (with `file`), `pursuit` (with the settings of `PursuitConfig`)
            or `none`; the first two need `path` and take `placed`.
        two_way: Whether the car brakes and reverses: no drive is throttle 0, not -1.

    Raises:
        ValueError: A key or a file is missing or wrong, or the policy is of the other kind of car.
    """
    settings = dict(about)
    kind = settings.pop("kind", None)
    if kind == "none" and not settings:
        return None
    own = {name: settings.pop(name) for name in PlacedPath._fields if name in settings}
    course = section(PlacedPath, own, "policy")
    if kind == "exported" and set(settings) == {"file"}:
        policy = Policy.load(settings["file"])
        if policy.two_way != two_way:
            trained = "with" if policy.two_way else "without"
            raise ValueError(
                f"policy {settings['file']} was trained on a car {trained} reverse, but "
                f"car.two_way is {str(two_way).lower()}: make them equal"
            )
        return PathDriver(policy, course)
    if kind == "pursuit":
        return PathDriver(Pursuit.from_dict(settings, two_way), course)
    raise ValueError(
        f'policy={dict(about)!r}: must be {{"kind": "exported", "file": F, "path": P}}, '
        '{"kind": "pursuit", "path": P} or {"kind": "none"}'
    )
