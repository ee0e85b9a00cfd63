"""Names of drivers -> the drivers; a driver's module is imported when it is named."""

import importlib
from typing import Any, Dict, Mapping, Tuple

SENSORS = {
    "simulated": "buggy_rl.car.simulated:SimulatedSensor",
    "t265": "buggy_rl.car.camera_t265:T265",
}
ACTUATORS = {
    "simulated": "buggy_rl.car.simulated:SimulatedActuator",
    "pca9685": "buggy_rl.car.pwm_pca9685:PCA9685",
}
PILOTS = {
    "scripted": "buggy_rl.car.scripted:ScriptedPilot",
    "joystick": "buggy_rl.car.joystick:Joystick",
    "keyboard": "buggy_rl.car.keyboard:Keyboard",
}


def device_class(
    drivers: Mapping[str, str], about: Mapping[str, Any], place: str
) -> Tuple[Any, Dict[str, Any]]:
    """The class that a section of the config names by `kind`, and its settings.

    Raises:
        ValueError: The kind is unknown.
    """
    settings: Dict[str, Any] = dict(about)
    kind = settings.pop("kind", None)
    if kind not in drivers and ":" not in str(kind):
        known = ", ".join(sorted(drivers))
        raise ValueError(f"{place}.kind={kind!r}: must be one of {known}, or MODULE:CLASS")
    module, _, name = drivers.get(kind, kind).partition(":")
    return getattr(importlib.import_module(module), name), settings


def make_device(drivers: Mapping[str, str], about: Mapping[str, Any], place: str) -> Any:
    """The driver that a section of the config names by `kind`.

    Args:
        drivers: `SENSORS`, `ACTUATORS` or `PILOTS`.
        about: `kind`, one of the names or MODULE:CLASS of a driver of your own, and the driver's
            own settings, which its class method `from_dict(settings)` checks.
        place: What messages call the section.

    Raises:
        ValueError: The kind is unknown or a setting is invalid.
        OSError: The device cannot be opened.
    """
    found, settings = device_class(drivers, about, place)
    return found.from_dict(settings)
