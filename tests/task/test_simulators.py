"""Simulators as users name them: engines, files, and files with missing physics in them."""

import pytest
import torch
import yaml

from buggy_rl.core import keys
from buggy_rl.policies.training.run import EngineConfig, new_engine
from buggy_rl.simulators import make_engine, read_simulator
from buggy_rl.task.env import make_env, make_simulator

REPAIRED = {
    "engine": "single_track",
    "parameters": {"mass": 2.0},
    "effects": {"steering_gain": {"gain": 0.5}, "sensor_yaw": {"angle": 0.1}},
}


@pytest.fixture
def repaired(tmp_path):
    file = tmp_path / "repaired.yaml"
    file.write_text(yaml.safe_dump(REPAIRED))
    return file


def driven(env, steering=0.4, steps=30):
    state = env.reset()
    for _ in range(steps):
        state[keys.ACTION] = torch.tensor([0.0, steering]).expand(*env.batch_size, 2)
        state = env.step(state)["next"]
    return state


def test_a_file_says_engine_parameters_and_effects(repaired):
    content = read_simulator(repaired)
    assert content["engine"] == "single_track"
    assert content["effects"]["steering_gain"] == {"gain": 0.5}
    assert content["options"] == {}


def test_half_the_steering_in_a_file_is_half_the_steering_by_hand(repaired):
    env = make_simulator(repaired, 2)
    assert env.base_env.values["mass"].item() == 2.0
    by_hand = driven(make_engine("single_track", 2, parameters={"mass": 2.0}), 0.2)
    state = driven(env)
    torch.testing.assert_close(state[keys.POSE], by_hand[keys.POSE])
    # The sensor is turned to the left by 0.1 rad: it shows the car turned as much.
    turned = state[keys.MEASURED_POSE][:, 2] - state[keys.POSE][:, 2]
    torch.testing.assert_close(turned.abs(), torch.full((2,), 0.1), atol=1e-5, rtol=0)


def test_a_file_of_a_file_keeps_what_both_say(repaired, tmp_path):
    outer = tmp_path / "deeper" / "again.yaml"
    outer.parent.mkdir()
    outer.write_text(
        "engine: ../repaired.yaml\nparameters: {mass: 3.0}\neffects: {viscous_drag: {rate: 0.5}}\n"
    )
    env = make_simulator(outer, 1)
    assert env.base_env.values["mass"].item() == 3.0
    names = [transform.name for transform in env.transform]
    assert sorted(names) == ["sensor_yaw", "steering_gain", "viscous_drag"]


def test_an_engine_alone_refuses_effects_and_says_what_builds_them(repaired):
    with pytest.raises(ValueError, match="make_simulator"):
        make_engine(repaired)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("engine: single_track\neffect: {}\n", r"unknown keys \['effect'\]"),
        ("parameters: {mass: 2}\n", "needs the key 'engine'"),
        ("engine: single_track\neffects: {ice: {}}\n", "no effect 'ice'"),
        ("engine: single_track\neffects: {steering_gain: {gian: 1}}\n", "gian"),
        ("engine: single_track\neffects: {steering_gain: {gain: -5}}\n", "gain"),
    ],
)
def test_a_wrong_file_is_refused_with_what_is_wrong(tmp_path, content, words):
    file = tmp_path / "wrong.yaml"
    file.write_text(content)
    with pytest.raises(ValueError, match=words):
        make_simulator(file)
    with pytest.raises(ValueError, match="there is no simulator file"):
        make_simulator(tmp_path / "missing.yaml")


def test_a_task_stands_on_a_repaired_simulator(repaired):
    env = make_env(repaired, batch_size=2)
    rollout = env.rollout(5)
    assert rollout["next", "reward"].isfinite().all()
    assert env.base_env.values["mass"].item() == 2.0


def test_a_policy_is_trained_in_a_repaired_simulator(repaired):
    env = new_engine(EngineConfig(simulator=str(repaired), parameters={"mass": 2.5}), 2)
    assert {t.name for t in env.transform} == {"sensor_yaw", "steering_gain"}
    assert env.base_env.values["mass"].item() == 2.5
