import math
from types import SimpleNamespace

import pytest
import torch

from buggy_rl.diagnosis.answer.answer import describe_unexplained
from buggy_rl.diagnosis.config import DEFAULTS
from buggy_rl.diagnosis.residuals import unexplained
from buggy_rl.estimation.evidence import NO_BASELINE, BaselineMisfit
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import cut_segments
from tests.diagnosis.test_localisation import drives, rows_of


def whitened(segments, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(len(segments), 60, generator=generator, dtype=torch.float64)


def remaining(segments, before, after, usual=NO_BASELINE):
    problem = SimpleNamespace(segments=segments, simulation=Simulation(lambda count: None))
    return unexplained(problem, before, after, DEFAULTS.depends_share, usual)


def test_noise_is_described_as_noise():
    segments = cut_segments(drives(), 1.0, 0.5)
    rest = remaining(segments, 3 * whitened(segments), whitened(segments, 1))
    assert abs(rest.excess) < 0.1
    assert rest.share < 0.05
    assert rest.depends_on == []
    assert not rest.memory
    assert describe_unexplained(rest) == "What remains is noise."


def test_planted_structure_is_described_by_channel_and_the_condition_it_grows_with():
    segments = cut_segments(drives(), 1.0, 0.5)
    after = whitened(segments, 1).view(len(segments), 10, 6)
    steering = segments.action[:, rows_of(segments), 1]
    after[..., 5] += 4 * (steering > 0.3)
    rest = remaining(segments, 5 * whitened(segments), after.flatten(1))
    assert rest.channel["yaw_rate"] > 0.8
    assert rest.depends_on[0] == "steering"
    assert "yaw_rate; it grows with steering" in describe_unexplained(rest)


def test_a_residual_that_persists_from_instant_to_instant_is_memory():
    segments = cut_segments(drives(), 1.0, 0.5)
    after = whitened(segments, 1).view(len(segments), 10, 6)
    after[..., 3] += 3 * torch.sign(whitened(segments, 2)[:, :1])
    assert remaining(segments, after.flatten(1), after.flatten(1)).memory


def test_the_excess_of_the_baseline_is_not_unexplained_but_not_closed_either():
    segments = cut_segments(drives(), 1.0, 0.5)
    usual = BaselineMisfit(mean=0.2, error=0.1)
    # Excess 1 at first and 0.4 at last: within 0.2 + 3 * 0.1, but (0.4 - 0.2) / (1 - 0.2) open.
    rest = remaining(segments, 2 * flat(segments), 1.4 * flat(segments), usual)
    assert rest.share == 0.0
    assert rest.unclosed == pytest.approx(0.25, rel=0.01)
    # As little as on the baseline, of standard error 0.1: E[max(0, x)] is 0.1 / sqrt(2 pi).
    rest = remaining(segments, 2 * flat(segments), 1.2 * flat(segments), usual)
    assert rest.unclosed == pytest.approx(0.1 / (2 * math.pi) ** 0.5 / 0.8, rel=1e-3)
    # Less than that: nearly nothing; and where recordings do not differ, nothing at all.
    rest = remaining(segments, 2 * flat(segments), 1.0 * flat(segments), usual)
    assert 0 < rest.unclosed < 0.002
    same = BaselineMisfit(mean=0.2)
    rest = remaining(segments, 2 * flat(segments), 1.0 * flat(segments), same)
    assert rest.unclosed == 0.0


def flat(segments):
    return torch.ones(len(segments), 60, dtype=torch.float64)
