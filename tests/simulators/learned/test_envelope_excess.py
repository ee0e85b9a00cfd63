"""How far a learned simulator is asked beyond its training data: a number with a slope."""

import torch

from buggy_rl.simulators.learned.base import BINS, Envelope


def envelope():
    """Trained on a square of vx and vy with a corner cut off, other inputs anywhere in [0, 1]."""
    torch.manual_seed(0)
    rows = torch.rand(20_000, 5)
    fitted = Envelope()
    fitted.fit(rows[rows[:, 0] + rows[:, 1] < 1.2])
    return fitted


def row(vx, vy):
    return torch.tensor([[vx, vy, 0.5, 0.5, 0.5]], requires_grad=True)


def test_inside_it_is_nothing_and_outside_it_grows_with_the_distance():
    fitted = envelope()
    assert fitted.measured(row(0.4, 0.4))[1].item() == 0.0
    near, far = (
        fitted.measured(row(0.75, 0.75))[1].item(),
        fitted.measured(row(0.95, 0.95))[1].item(),
    )
    assert 0.0 < near < far
    # From (0.95, 0.95) to x + y = 1.2 it is 0.7 / sqrt(2) = 0.49, of which cells that are counted
    # as inside take about two.
    assert abs(far - 0.49) < 3.5 / BINS


def test_beyond_the_range_of_an_input_its_distance_counts_too():
    fitted = envelope()
    beyond = fitted.measured(row(-0.3, 0.4))[1].item()
    assert 0.25 < beyond < 0.35


def test_its_gradient_leads_back_to_the_data():
    fitted = envelope()
    for vx, vy in ((0.9, 0.9), (0.8, 0.7), (-0.2, 0.5), (0.5, 1.3)):
        there = row(vx, vy)
        before = fitted.measured(there)[1]
        (slope,) = torch.autograd.grad(before.sum(), there)
        assert torch.isfinite(slope).all()
        after = fitted.measured(there - 0.02 * slope / slope.norm())[1]
        assert after.item() < before.item()


def test_a_loaded_envelope_measures_as_the_saved_one():
    fitted, loaded = envelope(), Envelope()
    loaded.load_state_dict(fitted.state_dict())
    there = row(0.9, 0.95)
    torch.testing.assert_close(loaded.measured(there)[1], fitted.measured(there)[1])
