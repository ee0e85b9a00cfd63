"""What is measured without a simulator, on recordings of known motion."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from buggy_rl.core import keys
from buggy_rl.proof.real.measures import cut_windows, measured
from buggy_rl.recordings import Recording


def circle(speed, curvature, throttle=0.0, steering=0.4, rows=800, name="drive"):
    """A drive of constant speed and curvature [1/m], with noise of 1 % of the speed."""
    generator = torch.Generator().manual_seed(round(1000 * speed))
    vx = speed * (1 + 0.01 * torch.randn(rows, generator=generator))
    velocity = torch.stack([vx, torch.zeros(rows), curvature * speed * torch.ones(rows)], -1)
    action = torch.tensor([throttle, steering]).expand(rows, 2)
    data = {
        keys.TIME: 0.01 * torch.arange(rows, dtype=torch.float64).unsqueeze(-1),
        keys.POSE: torch.zeros(rows, 3),
        keys.VELOCITY: velocity,
        keys.ACTION: action,
        keys.SEGMENT: torch.zeros(rows, dtype=torch.long),
    }
    return Recording(name, TensorDict(data, [rows]), 0.01)


def by_name(before, after):
    return {m.name.partition(" at ")[0]: m for m in measured(before, after)}


def test_ratios_are_those_of_the_motion():
    found = by_name([circle(1.0, 0.8)], [circle(1.2, 1.0)])
    # 1.0^2 * 0.8 = 0.8 m/s^2 before, 1.2^2 * 1.0 = 1.44 after: 1.8 times.
    assert found["largest lateral acceleration"].ratio == pytest.approx(1.8, rel=0.02)
    assert found["speed"].ratio == pytest.approx(1.2, rel=0.01)
    assert found["curvature"].ratio == pytest.approx(1.25, rel=0.01)
    assert found["curvature"].before == pytest.approx(0.8, rel=0.01)
    for m in found.values():
        assert m.low <= m.ratio <= m.high


def test_where_nothing_changed_the_interval_holds_one():
    for m in measured([circle(1.0, 0.8)], [circle(1.0, 0.8)]):
        assert m.low <= 1 <= m.high
        assert m.high - m.low < 0.02


def test_other_commands_are_not_compared():
    found = by_name([circle(1.0, 0.8)], [circle(1.2, 1.0, throttle=0.5)])
    assert set(found) == {"largest lateral acceleration", "curvature"}
    assert by_name([circle(1.0, 0.8)], [circle(1.2, 1.0, steering=0.8)]) == {}


def test_a_curvature_at_the_limit_tells_nothing_of_the_steering():
    found = by_name([circle(3.0, 0.8)], [circle(3.0, 0.7)])  # 7.2 m/s^2
    assert set(found) == {"largest lateral acceleration", "speed"}


def test_windows_in_which_a_command_moved_are_not_steady():
    drive = circle(1.0, 0.8)
    drive.data[keys.ACTION] = drive.data[keys.ACTION].clone()
    drive.data[keys.ACTION][400:, 0] = 0.3
    seen = cut_windows([drive])
    # Windows begin at 1.0, 1.5, ...; of those whose second before or own half holds 4.0 s, none is.
    start = 1.0 + 0.5 * np.arange(len(seen))
    assert start[seen.steady == 0].tolist() == [4.0, 4.5]


def test_a_car_that_stands_is_said_to_show_nothing():
    with pytest.raises(ValueError, match="parked: the car moves in no window"):
        cut_windows([circle(0.1, 0.8, name="parked")])
