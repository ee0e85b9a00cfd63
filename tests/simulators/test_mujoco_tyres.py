"""The explicit tyre law by itself."""

import numpy as np
import pytest

from buggy_rl.simulators.mujoco.forces import SLIP_STIFFNESS, SLOWEST_ROLLING, Tyre, tyre_force

GRIP, CORNERING, LOAD = 0.9, 8.0, 4.0  # [-], [1/rad], [N]


def force(slip_x, slip_y, rolling, load=None, shape=1.0):
    load = LOAD if load is None else load
    arrays = np.broadcast_arrays(*np.atleast_1d(slip_x, slip_y, rolling, load))
    sx, sy, v, fz = (np.asarray(a, np.float64)[None] for a in arrays)
    return tyre_force(sx, sy, v, fz, Tyre(GRIP, CORNERING, shape))


@pytest.mark.parametrize("speed", [-3.0, 0.2, 1.0, 3.0, 8.0])
def test_cornering_stiffness_is_the_same_at_every_speed(speed):
    angle = 1e-4  # rad, to the left of where the wheel points
    fy = force(0.0, -abs(speed) * np.tan(angle), speed).fy
    assert fy.item() == pytest.approx(-CORNERING * LOAD * angle, rel=1e-5)


def test_slip_stiffness_is_that_of_the_slip_ratio():
    # 0.1 % of 2 m/s
    assert force(0.002, 0.0, 2.0).fx.item() == pytest.approx(
        SLIP_STIFFNESS * LOAD * 0.001, rel=1e-3
    )


def test_the_force_stays_within_the_friction_circle_and_nearly_fills_it():
    rng = np.random.default_rng(0)
    slip_x, slip_y = rng.normal(0, 5, (2, 2000))
    rolling, load = rng.uniform(-5, 5, 2000), rng.uniform(0.1, 10, 2000)
    f = force(slip_x, slip_y, rolling, load)
    share = np.hypot(f.fx, f.fy) / (GRIP * load)
    assert share.max() <= 1.0
    assert share.max() > 0.99


def test_with_shape_one_the_force_comes_to_what_the_grip_allows():
    slip = np.linspace(0.01, 50.0, 200)
    s = CORNERING * slip / GRIP  # at 1 m/s
    expected = GRIP * LOAD * s / np.sqrt(1.0 + s**2)
    np.testing.assert_allclose(force(0.0, slip, 1.0).fy[0], expected, rtol=1e-12)


@pytest.mark.parametrize("shape", [1.3, 1.6])
def test_with_more_it_peaks_and_falls_in_a_slide(shape):
    peak = shape * np.tan(np.pi / 2 / shape) * GRIP / CORNERING  # of slip_y at 1 m/s
    slip = peak * np.array([0.8, 1.0, 1.5, 1e6])
    share = force(0.0, slip, 1.0, shape=shape).fy[0] / (GRIP * LOAD)
    assert share[1] == pytest.approx(1.0)
    assert share[0] < 1.0
    assert share[1] > share[2] > share[3]
    assert share[3] == pytest.approx(np.sin(shape * np.pi / 2), abs=1e-4)


def test_the_force_opposes_the_slip():
    rng = np.random.default_rng(1)
    slip_x, slip_y = rng.normal(0, 1, (2, 500))
    f = force(slip_x, slip_y, rng.uniform(-3, 3, 500))
    assert (f.fx * slip_x + f.fy * slip_y > 0).all()


def test_braking_costs_cornering_force():
    alone, both = force(0.0, -0.3, 2.0), force(-1.0, -0.3, 2.0)
    assert abs(both.fy.item()) < 0.6 * abs(alone.fy.item())


def test_a_parked_tyre_is_a_viscous_damper():
    f = force(0.0, 1e-4, 0.0)
    assert f.fy.item() == pytest.approx(CORNERING * LOAD * 1e-4 / SLOWEST_ROLLING, rel=1e-4)


def test_the_slopes_are_those_of_finite_differences():
    rng = np.random.default_rng(2)
    sx, sy, v = rng.normal(0, 0.3, 50), rng.normal(0, 0.3, 50), rng.uniform(0.0, 3.0, 50)
    f, step = force(sx, sy, v), 1e-6
    along, across = force(sx + step, sy, v), force(sx, sy + step, v)
    np.testing.assert_allclose((along.fx - f.fx) / step, f.fx_sx, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose((along.fy - f.fy) / step, f.fy_sx, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose((across.fx - f.fx) / step, f.fx_sy, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose((across.fy - f.fy) / step, f.fy_sy, rtol=1e-3, atol=1e-3)


def test_a_wheel_in_the_air_has_no_grip():
    f = force(1.0, 1.0, 1.0, load=0.0)
    assert f.fx.item() == f.fy.item() == 0.0
