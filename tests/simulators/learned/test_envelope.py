import torch

from buggy_rl.simulators.learned.base import Envelope


def driven() -> torch.Tensor:
    """Fast straight or slow in a turn, never fast in a turn."""
    generator = torch.Generator().manual_seed(0)
    rows = torch.rand(20_000, 5, generator=generator) * 2 - 1
    keep = (rows[:, 0] < 0.2) | (rows[:, 4].abs() < 0.3)
    return rows[keep]


def test_what_was_driven_lies_inside():
    envelope, rows = Envelope(), driven()
    envelope.fit(rows)
    # Only the tails of each input, 0.05 % on both sides of five inputs, count as outside.
    assert envelope.measured(rows)[0].float().mean() < 0.006


def test_beyond_the_range_of_one_input_is_outside():
    envelope = Envelope()
    envelope.fit(driven())
    beyond = torch.zeros(5, 5) + 3.0 * torch.eye(5)
    assert envelope.measured(beyond)[0].all()


def test_a_combination_never_driven_is_outside_though_each_input_was():
    envelope = Envelope()
    envelope.fit(driven())
    fast_turn = torch.tensor([0.9, 0.0, 0.0, 0.0, 0.9])
    fast, turning = fast_turn.clone(), fast_turn.clone()
    fast[4], turning[0] = 0.0, 0.0
    assert envelope.measured(fast_turn)[0].item()
    assert not envelope.measured(fast)[0].item()
    assert not envelope.measured(turning)[0].item()


def test_what_is_no_number_is_outside_and_no_crash():
    envelope = Envelope()
    envelope.fit(driven())
    rows = torch.full((2, 5), float("nan"))
    rows[0] = driven()[0]
    outside, excess = envelope.measured(rows)
    assert outside[1].item()
    assert excess[1].isnan().item()
    torch.testing.assert_close(outside[:1], envelope.measured(rows[:1])[0])
    assert excess[0].isfinite().item()
