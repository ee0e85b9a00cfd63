"""What gyroscope and wheel speeds say without a simulator."""

import numpy as np
import pytest
import torch
from scipy.integrate import cumulative_trapezoid
from tensordict import TensorDict

from buggy_rl.diagnosis.answer.other_sensors import EARLY, SensorFinding, other_sensors
from buggy_rl.diagnosis.answer.other_sensors import LATE as LATE_POSE
from buggy_rl.recordings import Recording

DT, SECONDS = 0.01, 60.0
LATE, SCALE, BIAS = 0.042, 1.03, 0.02
RADIUS, SLIP = 0.97, 0.025  # wheel speed over the car's; slip ratio for an acceleration of 1 m/s^2


def smooth(generator, n, period=0.8):
    """A signal [n] of unit standard deviation that changes over `period` [s]."""
    window = np.hanning(round(period / DT))
    signal = np.convolve(generator.standard_normal(n + len(window)), window, "same")[:n]
    return signal / signal.std()


def recording(seed=0, late=LATE, slip=SLIP, noise=0.02, **changes):
    generator, n = np.random.default_rng(seed), round(SECONDS / DT)
    t = np.arange(n) * DT
    rate, vx = 1.5 * smooth(generator, n), 2.5 + 0.8 * smooth(generator, n, 2.0).clip(-2.5, 2.5)
    yaw = cumulative_trapezoid(rate, dx=DT, initial=0.0)
    pull = np.gradient(vx, DT)
    seen = np.interp(t - late, t, yaw) + 0.001 * generator.standard_normal(n)
    velocity = np.stack([np.interp(t - late, t, vx), 0 * t, np.interp(t - late, t, rate)], -1)
    data = {
        "pose": np.stack([0 * t, 0 * t, seen], -1),
        "velocity": velocity,
        "action": np.zeros((n, 2)),
        "gyro": (SCALE * rate + BIAS + noise * generator.standard_normal(n))[:, None],
        "wheel_speed": (RADIUS * vx * (1 + slip * pull))[:, None],
        **changes,
    }
    tensors = {
        k: torch.tensor(np.asarray(v), dtype=torch.float32)
        for k, v in data.items()
        if v is not None
    }
    tensors["t"] = torch.from_numpy(t[:, None])
    tensors["segment"] = torch.from_numpy((t > SECONDS / 2).astype(np.int64))
    return Recording(f"drive_{seed}", TensorDict(tensors, [n]), DT)


def findings(*recordings):
    return {f.name: f for f in other_sensors(recordings)}


@pytest.mark.parametrize("seed", range(3))
def test_lateness_scale_bias_and_slip_are_found(seed):
    found = findings(recording(seed))
    hard = 1 / SLIP
    truths = {
        "pose_lateness": (LATE, 0.002),
        "gyro_scale": (SCALE, 0.01),
        "gyro_bias": (BIAS, 0.01),
        "wheel_scale": (RADIUS, 0.005),
    }
    for name, (truth, within) in truths.items():
        assert found[name].value == pytest.approx(truth, abs=within), name
        assert found[name].high - found[name].low < 4 * within, name
    slip = found["wheel_slip"]
    acceleration = float(slip.words.split()[1])
    assert slip.value * hard == pytest.approx(acceleration, rel=0.1)


def test_a_pose_in_time_and_wheels_without_slip_are_none():
    found = findings(recording(1, late=0.0, slip=0.0))
    assert abs(found["pose_lateness"].value) < 0.002
    assert found["pose_lateness"].low < 0.001
    assert abs(found["wheel_slip"].value) < 0.01


def test_without_these_sensors_nothing_is_said():
    assert findings(recording(gyro=None, wheel_speed=None)) == {}


def test_a_gyroscope_that_does_not_follow_the_car_says_nothing():
    noise = np.random.default_rng(5).standard_normal((round(SECONDS / DT), 1))
    assert findings(recording(gyro=noise, wheel_speed=None)) == {}


def test_without_a_gyroscope_a_late_pose_is_not_taken_for_slip():
    found = findings(recording(2, slip=0.0, gyro=None))
    assert set(found) == {"wheel_scale", "wheel_slip"}
    assert abs(found["wheel_slip"].value) < 0.02


def test_rows_without_a_value_are_left_out():
    whole = recording(3)
    holed = whole.data["gyro"].clone()
    holed[1000:1200] = torch.nan
    found = findings(recording(3, gyro=holed))
    assert found["pose_lateness"].value == pytest.approx(LATE, abs=0.002)


def test_a_gyroscope_that_is_stamped_late_is_said_to_be():
    finding = findings(recording(0, late=-0.09))["pose_lateness"]
    assert finding.value == pytest.approx(-0.09, abs=0.002)
    assert finding.line().startswith("the gyroscope comes after the pose")
    assert "90 ms (" in finding.line()


def test_a_line_says_value_and_interval():
    line = findings(recording(0))["pose_lateness"].line()
    assert line.startswith("the pose comes after the gyroscope by 42 ms (4")


def test_a_pose_that_comes_early_is_said_with_its_bounds_in_order():
    early = SensorFinding("pose_lateness", LATE_POSE, "s", -0.03, -0.032, -0.029)
    assert early.line() == f"{EARLY} 30 ms (29 to 32)"
