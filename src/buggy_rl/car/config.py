"""The config file of a car: JSON, each section checked where it is used."""

import json
from typing import Any, Mapping, NamedTuple, Union

from buggy_rl.car.interfaces import Command, neutral_of
from buggy_rl.car.safety import Geofence, Safety, make_geofence
from buggy_rl.car.settings import section

ASKING = ("pca9685", "buggy_rl.car.ros:AckermannActuator", "joystick", "keyboard")
SECTIONS = ("sensor", "actuator", "pilot", "policy")


class CarConfig(NamedTuple):
    """What is on the car and what it may do."""

    sensor: Mapping[str, Any]
    """`kind` and settings of the driver, as of `devices.SENSORS`."""
    actuator: Mapping[str, Any]
    """`kind` and settings of the driver, as of `devices.ACTUATORS`."""
    pilot: Mapping[str, Any]
    """`kind` and settings of the person with the button, as of `devices.PILOTS`."""
    policy: Mapping[str, Any]
    """`kind` and settings, as of `driver.make_driver`."""
    output: str
    """Folder of the recordings."""
    geofence: Union[str, Mapping[str, Any]]
    """Area where the car may be, as of `geofence.make_geofence`."""
    safety: Mapping[str, Any] = {}
    """Limits that differ from those of `Safety`."""
    two_way: bool = False
    """Whether the speed controller brakes and reverses: no drive is throttle 0, -1 full brake or
    reverse. False: no drive is -1, and there is no reverse."""
    period: float = 0.01
    """Control period [s]; that of the policy."""
    speed: float = 1.0
    """Speed of time; above 1 only for a simulated car."""

    @property
    def at_rest(self) -> Command:
        """No drive, wheels straight ahead."""
        return neutral_of(self.two_way)

    def told(self, about: Mapping[str, Any]) -> Mapping[str, Any]:
        """A section with `two_way`, where its driver is one of ours that asks for it.

        A driver of one's own is given commands as they are.
        """
        if not self.two_way or about["kind"] not in ASKING:
            return about
        return dict(about, two_way=True)

    @property
    def limits(self) -> Safety:
        """The safety limits."""
        return Safety.from_dict(self.safety)

    @property
    def fence(self) -> Geofence:
        """Fence of the area where the car may be."""
        return make_geofence(self.geofence)


RANGES = {"period": (0.002, 0.05), "speed": (0.1, 20.0)}


def make_config(content: Mapping[str, Any]) -> CarConfig:
    """A config of plain values, checked.

    Raises:
        ValueError: A key is missing or unknown, or a value is not allowed.
    """
    config = section(CarConfig, content, "car", RANGES)
    for name in SECTIONS:
        about = getattr(config, name)
        if not isinstance(about, Mapping) or not isinstance(about.get("kind"), str):
            raise ValueError(f'car.{name}={about!r}: must be an object with a "kind"')
    if config.speed != 1.0 and {config.sensor["kind"], config.actuator["kind"]} != {"simulated"}:
        raise ValueError(f"car.speed={config.speed:g}: time of a real car runs at speed 1")
    if not config.output:
        raise ValueError("car.output is empty: name the folder of the recordings")
    make_geofence(config.geofence)
    Safety.from_dict(config.safety)
    return config


def load_config(file: str) -> CarConfig:
    """Reads and checks a config file.

    Raises:
        ValueError: It is not JSON or not such a config; the message names the file.
        OSError: It cannot be read.
    """
    with open(file) as stream:
        try:
            return make_config(json.load(stream))
        except ValueError as error:
            raise ValueError(f"{file}: {error}") from None
