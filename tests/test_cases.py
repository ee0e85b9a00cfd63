"""The concealed cases themselves: one seed, one riddle, and a known answer."""

import pytest
import torch

from buggy_rl.core import keys
from buggy_rl.recordings.camera import CameraConfig
from buggy_rl.simulators.reference.faults import FAULTS, OF_A_COMMAND
from tests.cases import CAMERA, NOTHING, SIZES, UNKNOWN_SIZES, Case, concealing, draw, make_drives

QUIET = CameraConfig(0.0, 0.0, 0.0, 0.0)


def test_there_is_a_case_for_every_fault_and_every_error_of_the_camera():
    drawn = {f"{case.name}.{name}" for case in draw(0) for name in case.parameters}
    camera = {f"{effect}.{name}" for effect, errors in CAMERA.items() for name in errors}
    one_way = {fault.name for fault in FAULTS} - {fault.name for fault in OF_A_COMMAND}
    assert drawn == one_way | camera
    assert len(SIZES) >= 22
    assert not set(SIZES) & set(UNKNOWN_SIZES)
    assert Case("wind").known
    assert not Case("sticky_servo").known


def test_sizes_are_drawn_by_the_seed_within_their_ranges():
    assert draw(3) == draw(3)
    assert draw(3) != draw(4)
    for seed in range(20):
        for case in draw(seed):
            for name, value in case.parameters.items():
                low, high, signed = (SIZES | UNKNOWN_SIZES)[case.name][name]
                assert low <= (abs(value) if signed else value) <= high
    signs = {draw(seed, ["gyro_bias"])[0].parameters["bias"] > 0 for seed in range(9)}
    assert signs == {True, False}


def test_each_car_has_its_own_fault_and_nothing_is_nothing():
    cases = [Case("payload", {"mass_ratio": 1.5}), NOTHING, Case("gyro_bias", {"bias": 0.1})]
    engine = concealing(cases, 2)
    mass = engine.car.chassis.mass
    assert (mass / 1.625).tolist() == [1.5, 1.5, 1.0, 1.0, 1.0, 1.0]
    cameras = [case.camera(QUIET) for case in cases]
    assert cameras[0] == cameras[1] == QUIET
    assert cameras[2] == CameraConfig(0.0, 0.0, 0.0, 0.0, gyro_bias=0.1)


@pytest.mark.slow
def test_drives_are_made_by_the_seed_and_show_the_case():
    cases = [NOTHING, Case("steering_gain", {"gain": 0.7}), Case("speed_scale", {"ratio": 0.9})]
    one, two, other = (make_drives(cases, seed=seed, seconds=1.2) for seed in (2, 2, 5))
    for first, second, third in zip(one, two, other, strict=True):
        assert len(first.train) == 2
        assert len(first.held_out) == 1
        for drives in (first, second, third):
            recordings = drives.train + drives.held_out
            assert all(len(recording) == 120 for recording in recordings)
        data = [drives.train[0].data for drives in (first, second, third)]
        assert (data[0] == data[1]).all()
        assert not torch.equal(data[0][keys.VELOCITY], data[2][keys.VELOCITY])
    names = {r.name for drives in one for r in drives.train + drives.held_out}
    assert len(names) == 9
    assert not any(case.name in name for name in names for case in cases)
