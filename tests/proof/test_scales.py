"""Cases of cars of other sizes: effects, drives, camera and question are scaled together."""

import json
from dataclasses import replace

import pytest
import torch
import yaml

from buggy_rl.core import keys
from buggy_rl.core.car_file import load_car
from buggy_rl.proof.baselines.asked import open_question
from buggy_rl.proof.cases.case import Case
from buggy_rl.proof.cases.draw import DrawConfig, case_at_scale, draw
from buggy_rl.proof.cases.drives import drive_cases
from buggy_rl.proof.cases.sealing import CaseStore, groups, seal
from buggy_rl.proof.cases.simulators import similar_camera as camera_at_scale
from buggy_rl.proof.plants import abilities
from buggy_rl.recordings.camera import CameraConfig

CAN = {"reference": abilities("reference")}
BRAKED = DrawConfig(pairings=["reference_brakes"])
LATE = {"steering_dead_time": {"dead_time": 0.05}, "one_sided_drag": {"yaw_acceleration": 10.0}}
CASE = Case(
    7, "reference", "reference", concealed=LATE, command="brakes", seconds=2.0, drives=2, held_out=0
)


def test_scales_are_drawn_and_leave_the_rest_as_it_was():
    both = replace(BRAKED, scales=[1.0, 4.0], families=["one"])
    cases = [
        (draw(s, replace(BRAKED, families=["one"]), CAN), draw(s, both, CAN)) for s in range(30)
    ]
    assert {after.scale for _, after in cases} == {1.0, 4.0}
    for before, after in cases:
        assert case_at_scale(before, after.scale) == after
        assert after.truth == before.truth


def test_sizes_follow_the_laws_of_similarity_and_delays_stay():
    large = case_at_scale(CASE, 4.0)
    assert large.concealed["one_sided_drag"] == {"yaw_acceleration": 2.5}
    assert large.concealed["steering_dead_time"] == {"dead_time": 0.05}
    assert large.seconds == 4.0  # twice as long for four times the length
    lag = case_at_scale(replace(CASE, concealed={"steering_lag": {"time_constant": 0.1}}), 4.0)
    assert lag.concealed["steering_lag"]["time_constant"] == pytest.approx(0.2)
    assert case_at_scale(CASE, 1.0) is CASE


def test_the_camera_s_noise_is_as_large_a_part_of_the_motion():
    usual, large = (
        CameraConfig(),
        camera_at_scale(CameraConfig(), case_at_scale(CASE, 4.0).car.similarity),
    )
    assert large.position_noise == pytest.approx(4 * usual.position_noise)
    assert large.velocity_noise == pytest.approx(2 * usual.velocity_noise)
    assert large.yaw_rate_noise == pytest.approx(usual.yaw_rate_noise / 2)
    assert large.yaw_noise == usual.yaw_noise


def test_a_larger_car_drives_about_a_larger_room():
    short = replace(CASE, seconds=1.0)
    buggy, large = (
        drive_cases([case_at_scale(short, s)])[0].changed[keys.POSE] for s in (1.0, 4.0)
    )
    assert large.shape[1] == 2 * buggy.shape[1]
    start = torch.tensor([4.0, 4.0, 1.0])
    torch.testing.assert_close(large[:, 0], buggy[:, 0] * start)
    assert 4.0 < large[..., :2].abs().max() < 16.0
    assert buggy[..., :2].abs().max() < 4.0


def test_only_the_reference_car_has_another_size():
    with pytest.raises(ValueError, match="only the reference car has another size"):
        replace(CASE, plant="mujoco", simulator="mujoco", command="throttle", scale=4.0)


@pytest.mark.parametrize("rate", [20, 100])
def test_a_sealed_case_is_asked_with_its_car_its_rate_and_its_command(tmp_path, rate):
    case = case_at_scale(replace(CASE, rate=rate, concealed={}, seconds=1.0), 4.0)
    store = CaseStore(tmp_path / "shown", tmp_path / "sealed")
    seal(store, [case], [])
    folder = store.inputs(case.id)
    car = load_car(str(folder / "car.yaml"))
    assert car.similarity == case.car.similarity
    content = yaml.safe_load((folder / "simulator.yaml").read_text())
    assert content["options"]["dimensions"] == dict(case.car.dimensions)
    question = open_question(folder)
    assert {r.command for r in question.recordings} == {case.longitudinal}
    assert {r.dt for r in question.recordings} == {1 / rate}
    assert json.loads(store.truth(case.id).read_text())["case"]["scale"] == 4.0
    assert len(groups([case, replace(CASE, rate=rate, seconds=1.0)])) == 2
