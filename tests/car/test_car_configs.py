"""The config files that docs/car.md starts from are valid, each section by its driver's rules."""

from pathlib import Path

import pytest

from buggy_rl.car.camera_t265 import RANGES as T265_RANGES
from buggy_rl.car.camera_t265 import CameraMount
from buggy_rl.car.drive import load_config
from buggy_rl.car.human import HumanConfig
from buggy_rl.car.joystick import RANGES as JOYSTICK_RANGES
from buggy_rl.car.joystick import PadLayout
from buggy_rl.car.keyboard import RANGES as KEYBOARD_RANGES
from buggy_rl.car.pwm_pca9685 import RANGES as BOARD_RANGES
from buggy_rl.car.pwm_pca9685 import Wiring
from buggy_rl.car.ros import ACKERMANN_RANGES, ODOMETRY_RANGES, Ackermann, Odometry
from buggy_rl.car.settings import section

CONFIGS = sorted((Path(__file__).parents[2] / "configs" / "car").glob("*.json"))
SETTINGS = {
    "t265": (CameraMount, T265_RANGES),
    "pca9685": (Wiring, BOARD_RANGES),
    "joystick": (PadLayout, JOYSTICK_RANGES),
    "keyboard": (HumanConfig, KEYBOARD_RANGES),
    "buggy_rl.car.ros:OdometrySensor": (Odometry, ODOMETRY_RANGES),
    "buggy_rl.car.ros:AckermannActuator": (Ackermann, ACKERMANN_RANGES),
}


@pytest.mark.parametrize("file", CONFIGS, ids=lambda file: file.stem)
def test_a_config_is_valid_in_every_section(file):
    config = load_config(str(file))
    for place in ("sensor", "actuator", "pilot"):
        about = dict(getattr(config, place))
        kind, ranges = SETTINGS[about.pop("kind")]
        section(kind, about, place, ranges)
    assert config.limits.throttle_cap < -0.5  # a first drive is slow
    assert config.fence.holds(0.0, 0.0)
    assert not config.fence.holds(6.0, 0.0)


def test_there_is_one_for_each_way_to_connect_a_car():
    assert [file.stem for file in CONFIGS] == ["ros", "t265_pca9685"]
