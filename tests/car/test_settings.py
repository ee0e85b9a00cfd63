"""Config files: what they may say, and what an error says."""

import json
from typing import NamedTuple

import pytest

from buggy_rl.car.drive import load_config, make_config
from buggy_rl.car.interfaces import ACTUATORS, make_device
from buggy_rl.car.policy import make_path_driver
from buggy_rl.car.safety import RANGES, Safety
from buggy_rl.car.settings import section

CAR = {
    "sensor": {"kind": "t265"},
    "actuator": {"kind": "pca9685"},
    "pilot": {"kind": "joystick"},
    "policy": {"kind": "none"},
    "output": "drives",
    "geofence": {"circle": [0, 0, 3]},
}


class Made(NamedTuple):
    name: str
    count: int = 2
    share: float = 0.5
    mode: str = "slow"
    on: bool = True


ALLOWED = {"share": (0.0, 1.0), "mode": ("slow", "fast")}


def test_absent_keys_keep_their_defaults_and_whole_numbers_become_floats():
    made = section(Made, {"name": "a", "share": 1}, "part", ALLOWED)
    assert made == Made("a", 2, 1.0, "slow", True)
    assert isinstance(made.share, float)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({}, r"part\.name is missing"),
        ({"name": "a", "nmae": 1}, r"part\.nmae: unknown key; available: name, count"),
        ({"name": "a", "share": 1.5}, r"part\.share=1\.5: must be in \[0, 1\]"),
        ({"name": "a", "share": "1"}, r"part\.share='1': must be a finite number"),
        ({"name": "a", "share": float("nan")}, r"part\.share=nan: must be a finite number"),
        ({"name": "a", "count": 1.5}, r"part\.count=1\.5: must be a whole number"),
        ({"name": "a", "count": True}, r"part\.count=True: must be a whole number"),
        ({"name": "a", "mode": "quick"}, r"part\.mode='quick': must be one of slow, fast"),
        ({"name": "a", "on": 1}, r"part\.on=1: must be true or false"),
        ([1], r"part=\[1\]: must be an object"),
    ],
)
def test_an_error_names_key_value_and_expectation(content, message):
    with pytest.raises(ValueError, match=message):
        section(Made, content, "part", ALLOWED)


def test_the_default_limits_are_within_their_ranges():
    assert Safety.from_dict(Safety()._asdict()) == Safety()
    assert set(RANGES) == set(Safety._fields)


def test_disarming_before_coasting_is_refused():
    with pytest.raises(ValueError, match="disarm_after"):
        Safety.from_dict({"disarm_after": 0.02})


def test_a_whole_config_is_read(tmp_path):
    file = tmp_path / "car.json"
    file.write_text(json.dumps({**CAR, "safety": {"throttle_cap": -0.5}}))
    assert load_config(str(file)).limits.throttle_cap == -0.5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sensor": {}}, 'must be an object with a "kind"'),
        ({"geofence": {}}, "geofence"),
        ({"safety": {"throttle_cap": 2}}, "throttle_cap"),
        ({"speed": 2.0}, "time of a real car runs at speed 1"),
        ({"output": ""}, "output is empty"),
        ({"period": 0.0}, r"car\.period=0\.0: must be in"),
    ],
)
def test_an_error_names_the_file_too(tmp_path, change, message):
    file = tmp_path / "car.json"
    file.write_text(json.dumps({**CAR, **change}))
    with pytest.raises(ValueError, match=rf"car\.json: .*{message}"):
        load_config(str(file))


@pytest.mark.parametrize("key", CAR)
def test_a_fence_and_everything_else_must_be_stated(key):
    with pytest.raises(ValueError, match=rf"car\.{key} is missing"):
        make_config({name: value for name, value in CAR.items() if name != key})


def test_an_unknown_driver_is_refused_with_those_there_are():
    with pytest.raises(ValueError, match="must be one of pca9685, simulated"):
        make_device(ACTUATORS, {"kind": "pca"}, "actuator")


@pytest.mark.parametrize(
    "about", [{"kind": "exported"}, {"kind": "best"}, {"kind": "none", "path": "x"}], ids=str
)
def test_an_unknown_policy_is_refused(about):
    with pytest.raises(ValueError, match="policy"):
        make_path_driver(about)
