from dataclasses import dataclass, field

import torch
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.diagnosis.answer.located import locate
from buggy_rl.estimation.rollout import AS_GIVEN, Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.simulators import make_engine
from tests.drives import toy_drive

NOISE = torch.tensor([0.001, 0.001, 0.002, 0.01, 0.01, 0.01])


@dataclass(frozen=True)
class Held(Simulation):
    """A simulator that is right but for a planted residual [N, K, 6], read every tenth row."""

    planted: Tensor = field(default_factory=lambda: torch.empty(0))

    def residuals(self, segments, settings=AS_GIVEN, start_error=None):
        return self.planted.unsqueeze(0)

    def instants(self, segments):
        return torch.arange(10, segments.horizon + 1, 10)


def planted_where(segments, channel, inside):
    """Jumps of a channel by ten sd wherever a mask [N, K] of the readings of `locate` says so."""
    generator = torch.Generator().manual_seed(0)
    residual = torch.randn(*inside.shape, 6, generator=generator) * NOISE
    residual[..., channel] += (10 * float(NOISE[channel]) * inside).cumsum(1)
    return Held(lambda cars: make_engine("hold", cars), planted=residual)


def drives():
    return [toy_drive(name, 1500, seed) for seed, name in enumerate(("first", "second"))]


def located(channel, inside, segments):
    simulation = planted_where(segments, channel, inside(segments))
    return locate(simulation, segments, NOISE, ["first", "second"])


def rows_of(segments):
    return 30 + torch.arange(10, segments.horizon + 1, 10)


def test_an_error_is_found_in_its_channel_and_region():
    segments = cut_segments(drives(), 1.0, 1.0)

    def hard_left(segments):
        return segments.action[:, rows_of(segments), 1] > 0.4

    found = located(5, hard_left, segments)
    assert found.channel_share["yaw_rate"] > 0.9
    worst = found.regions[0]
    assert "steering" in worst.where
    assert worst.where["steering"][0] > 0.2
    assert worst.error_share > 2 * worst.data_share


def test_an_error_is_found_in_its_time():
    segments = cut_segments(drives(), 1.0, 1.0)

    def one_moment(segments):
        inside = torch.zeros(len(segments), 10)
        inside[(segments.recording == 1) & (segments.row == 500)] = 1.0
        return inside

    found = located(3, one_moment, segments)
    assert found.channel_share["vx"] > 0.9
    first = found.intervals[0]
    assert first.recording == "second"
    assert first.begin <= 5.4
    assert first.end >= 6.2
    assert first.error_share > 0.8  # the rest is noise that stands out


def test_time_since_the_start_does_not_depend_on_the_recordings_clock():
    late = toy_drive("late", 400, 0)
    late.data[keys.TIME] += 1000.0
    assert cut_segments([late], 1.0, 1.0).elapsed.tolist() == [0.0, 1.0, 2.0]
