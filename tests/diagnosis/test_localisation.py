import math
from dataclasses import dataclass, field

import pytest
import torch
from torch import Tensor

from buggy_rl import keys
from buggy_rl.diagnosis.answer import described
from buggy_rl.diagnosis.localisation import locate
from buggy_rl.diagnosis.unexplained import remaining
from buggy_rl.engines import make_engine
from buggy_rl.estimation.misfit import CAP, NOTHING, Usual, misfit, typical, usual
from buggy_rl.estimation.rollout import Player
from buggy_rl.estimation.segments import stretches
from tests.drives import toy_drive

NOISE = torch.tensor([0.001, 0.001, 0.002, 0.01, 0.01, 0.01])


@dataclass(frozen=True)
class Held(Player):
    """A simulator that is right but for a planted gap [N, K, 6], read every tenth row."""

    planted: Tensor = field(default_factory=lambda: torch.empty(0))

    def play(self, cut, effects, parameters=None, offset=None, shift=None):
        return self.planted.unsqueeze(0)

    def instants(self, cut):
        return torch.arange(10, cut.horizon + 1, 10)


def planted_where(cut, channel, inside):
    """Jumps of a channel by ten sd wherever a mask [N, K] of the readings of `locate` says so."""
    generator = torch.Generator().manual_seed(0)
    gap = torch.randn(*inside.shape, 6, generator=generator) * NOISE
    gap[..., channel] += (10 * float(NOISE[channel]) * inside).cumsum(1)
    return Held(lambda cars: make_engine("hold", cars), planted=gap)


def drives():
    return [toy_drive(name, 1500, seed) for seed, name in enumerate(("first", "second"))]


def located(channel, inside, cut):
    player = planted_where(cut, channel, inside(cut))
    return locate(player, cut, NOISE, ["first", "second"])


def rows_of(cut):
    return 30 + torch.arange(10, cut.horizon + 1, 10)


def test_an_error_is_found_in_its_channel_and_region():
    cut = stretches(drives(), 1.0, 1.0)

    def hard_left(cut):
        return cut.action[:, rows_of(cut), 1] > 0.4

    found = located(5, hard_left, cut)
    assert found.channel_share["yaw_rate"] > 0.9
    worst = found.regions[0]
    assert "steering" in worst.where
    assert worst.where["steering"][0] > 0.2
    assert worst.error_share > 2 * worst.data_share


def test_an_error_is_found_in_its_time():
    cut = stretches(drives(), 1.0, 1.0)

    def one_moment(cut):
        inside = torch.zeros(len(cut), 10)
        inside[(cut.drive == 1) & (cut.row == 500)] = 1.0
        return inside

    found = located(3, one_moment, cut)
    assert found.channel_share["vx"] > 0.9
    first = found.intervals[0]
    assert first.recording == "second"
    assert first.begin <= 5.4
    assert first.end >= 6.2
    assert first.error_share > 0.8  # the rest is noise that stands out


def white(cut, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(len(cut), 60, generator=generator, dtype=torch.float64)


def test_noise_is_told_to_be_noise():
    cut = stretches(drives(), 1.0, 0.5)
    rest = remaining(cut, torch.arange(10, 101, 10), 3 * white(cut), white(cut, 1))
    assert abs(rest.excess) < 0.1
    assert rest.share < 0.05
    assert rest.depends_on == []
    assert not rest.memory
    assert described(rest) == "What remains is noise."


def test_planted_structure_is_described_by_channel_and_what_it_grows_with():
    cut = stretches(drives(), 1.0, 0.5)
    after = white(cut, 1).view(len(cut), 10, 6)
    steering = cut.action[:, rows_of(cut), 1]
    after[..., 5] += 4 * (steering > 0.3)
    rest = remaining(cut, torch.arange(10, 101, 10), 5 * white(cut), after.flatten(1))
    assert rest.channel["yaw_rate"] > 0.8
    assert rest.depends_on[0] == "steering"
    assert "yaw_rate, growing with steering" in described(rest)


def test_what_goes_on_from_instant_to_instant_is_memory():
    cut = stretches(drives(), 1.0, 0.5)
    after = white(cut, 1).view(len(cut), 10, 6)
    after[..., 3] += 3 * torch.sign(white(cut, 2)[:, :1])
    assert remaining(cut, torch.arange(10, 101, 10), after.flatten(1), after.flatten(1)).memory


def test_a_spin_counts_as_no_more_than_the_cap():
    # (1 + 1 + 10) / 3 = 4, where the spin's own 1e3 would be all that is seen.
    square = torch.tensor([1.0, 1.0, 1e6])
    assert CAP == 100
    assert misfit(square) == 4.0
    assert typical(square) == 1.0


def test_where_all_is_beyond_the_cap_size_still_counts():
    assert misfit(torch.full((5,), 900.0)) == 30.0
    assert misfit(torch.full((5,), 400.0)) == 20.0


def test_a_spin_counts_as_closed_by_as_much_as_it_is():
    given = torch.tensor([1.0, 1.0, 100.0**2])
    assert misfit(given, given) == pytest.approx(4.0)
    # Half of the way from 100 to 1: half of what the cap lets count, 1 + 9 / 2.
    assert misfit(torch.tensor([1.0, 1.0, 50.5**2]), given) == pytest.approx((1 + 1 + 5.5) / 3)
    # Worse than given, it counts as no more than before; and noise alone is noise alone.
    assert misfit(torch.tensor([1.0, 1.0, 1e6]), given) == pytest.approx(4.0)
    assert misfit(torch.ones(3), given) == pytest.approx(1.0)


def test_features_do_not_depend_on_the_drives_clock():
    late = toy_drive("late", 400, 0)
    late.data[keys.TIME] += 1000.0
    assert stretches([late], 1.0, 1.0).elapsed.tolist() == [0.0, 1.0, 2.0]


def test_new_drives_may_be_as_wrong_as_old_ones_differ():
    # Blocks with means 0.8 and 1.2: spread 0.2828, over sqrt(9).
    old = torch.tensor([0.64, 0.64, 1.44, 1.44])
    found = usual(old, torch.tensor([0, 0, 1, 1]), 9)
    assert found.mean == pytest.approx(0.0, abs=1e-6)
    assert found.error == pytest.approx(0.2828 / 3, rel=1e-3)
    assert found.most == pytest.approx(0.2828, rel=1e-3)
    # Where all is noise, no less than what counts as nothing.
    assert usual(torch.full((4,), 0.9), torch.tensor([0, 0, 1, 1]), 9).most == NOTHING


def test_what_is_usual_is_no_excess_but_not_closed_either():
    cut = stretches(drives(), 1.0, 0.5)
    usually = Usual(mean=0.2, error=0.1)
    # Excess 1 at first and 0.4 at last: within 0.2 + 3 * 0.1, but (0.4 - 0.2) / (1 - 0.2) open.
    rest = remaining(cut, torch.arange(10, 101, 10), 2 * flat(cut), 1.4 * flat(cut), usually)
    assert rest.share == 0.0
    assert rest.unclosed == pytest.approx(0.25, rel=0.01)
    # As little as usual: drives differ by 0.1, E[max(0, x)] of which is 0.1 / sqrt(2 pi).
    rest = remaining(cut, torch.arange(10, 101, 10), 2 * flat(cut), 1.2 * flat(cut), usually)
    assert rest.unclosed == pytest.approx(0.1 / (2 * math.pi) ** 0.5 / 0.8, rel=1e-3)
    # Less than that: nearly nothing; and where drives do not differ, nothing at all.
    rest = remaining(cut, torch.arange(10, 101, 10), 2 * flat(cut), 1.0 * flat(cut), usually)
    assert 0 < rest.unclosed < 0.002
    same = Usual(mean=0.2)
    rest = remaining(cut, torch.arange(10, 101, 10), 2 * flat(cut), 1.0 * flat(cut), same)
    assert rest.unclosed == 0.0


def flat(cut):
    return torch.ones(len(cut), 60, dtype=torch.float64)
