"""The brush tyre alone: slip stiffness, saturation, relaxation and aligning moment."""

import numpy as np

from buggy_rl.proof.plants.rally.car import RallyCar
from buggy_rl.proof.plants.rally.tyre import CELLS, advance_bristles, bristle_force
from tests.proof.plants.rally.drives import parameters


def hold_slip(slip: float, speed: float, steps: int) -> tuple[dict, np.ndarray, np.ndarray]:
    """Constant side slip (tangent) at a rolling speed: constants, F_y / load and M_z by step."""
    k = RallyCar(parameters(5)).constants
    one = np.ones((5, 4))
    sliding = (0.0 * one, slip * speed * one, 0.0 * one)
    bristle, sides, moments = np.zeros((5, 4, 2, CELLS)), [], []
    for _ in range(steps):
        bristle = advance_bristles(k, bristle, sliding, speed * one, 0.7 * one, 0.001)
        _, side, moment = bristle_force(k, bristle, sliding, speed * one, one)
        sides.append(side)
        moments.append(moment)
    return k, np.array(sides), np.array(moments)


def test_slip_stiffness_and_aligning_moment() -> None:
    """A small slip gives stiffness times slip, opposed to it, and turns the wheel back."""
    k, side, moment = hold_slip(0.002, 1.0, 200)
    assert np.allclose(side[-1] / -0.002, k["stiffness_y"][:, None], rtol=0.06)
    # Positive side velocity: the trail (a sixth of the patch in the limit) gives M_z > 0.
    trail = moment[-1] / np.abs(side[-1]) / k["patch_length"]
    assert ((trail > 0.08) & (trail < 0.25)).all()


def test_full_sliding_reaches_the_friction_level() -> None:
    """Great slip: the force is the friction level, and the aligning moment vanishes."""
    _, side, moment = hold_slip(3.0, 1.0, 200)
    assert (np.abs(np.abs(side[-1]) / 0.7 - 1.0) < 0.05).all()
    assert np.abs(moment[-1]).max() < 0.15 * 0.7 * 0.036


def test_relaxation_is_a_way_not_a_time() -> None:
    """63 % of the force needs about the same way (below a patch length) at any speed."""
    ways = []
    for speed in (0.5, 2.0):
        k, side, _ = hold_slip(0.002, speed, 300)
        steps = 1 + (np.abs(side) < 0.63 * np.abs(side[-1])).sum(axis=0)
        ways.append(steps[:, 0] * 0.001 * speed / k["patch_length"])
    assert (np.array(ways) > 0.2).all()
    assert (np.array(ways) < 0.8).all()
    assert np.abs(ways[0] - ways[1]).max() < 0.2
