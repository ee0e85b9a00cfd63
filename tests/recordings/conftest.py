"""A recording with a known truth, to be read as it is or with one fault in it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

FINE = 1e-3  # [s] step of the truth
LEVER = 0.11  # [m] tracker ahead of the rear axle, which moves along the car
STEERING_LAG = 0.1  # [s]


def ideal_drive(
    seconds: float = 20.0,
    rate: float = 100.0,
    noise: float = 0.0,
    jitter: float = 0.0,
    agility: float = 1.0,
    seed: int = 0,
) -> pd.DataFrame:
    """A car with a rear axle that does not slip, seen by a tracker ahead of it.

    r = 1.2 agility v s,  v_tracker = (v, LEVER r): starts from rest and drives both ways round.

    Args:
        seconds: Length.
        rate: Rows a second.
        noise: White noise of the position [m]; yaw gets 4 rad/m of it, velocity 20 /s of it.
        jitter: Of the stamps, share of the period: the frame is taken when it is stamped.
        agility: Factor of the yaw rate; 3 turns at up to 3 rad/s.
        seed: Of noise and jitter.
    """
    fine = np.arange(0, seconds + FINE, FINE)
    v = 1.5 * (1 - np.exp(-fine / 1.0)) * (1 + 0.5 * np.sin(0.9 * fine))
    command = 0.6 * np.sin(1.3 * fine) * np.sin(0.37 * fine + 0.4)
    steering = np.empty_like(fine)
    steering[0] = 0.0
    for i in range(1, len(fine)):
        steering[i] = steering[i - 1] + FINE / STEERING_LAG * (command[i] - steering[i - 1])
    r = 1.2 * agility * v * steering
    yaw = 0.3 + np.concatenate([[0], np.cumsum((r[1:] + r[:-1]) / 2 * FINE)])
    vy = LEVER * r
    world = np.stack([np.cos(yaw) * v - np.sin(yaw) * vy, np.sin(yaw) * v + np.cos(yaw) * vy], -1)
    xy = np.concatenate([[[0, 0]], np.cumsum((world[1:] + world[:-1]) / 2 * FINE, 0)])
    random = np.random.default_rng(seed)
    t = np.arange(0, seconds, 1 / rate)
    t = np.clip(t + jitter / rate * random.uniform(-1, 1, len(t)), 0, seconds)

    def at(values: np.ndarray, spread: float) -> np.ndarray:
        return np.interp(t, fine, values) + spread * random.standard_normal(len(t))

    throttle = np.clip(0.4 * v - 0.4, -1, 1)
    return pd.DataFrame(
        {
            "t": t,
            "x": at(xy[:, 0], noise),
            "y": at(xy[:, 1], noise),
            "yaw": np.remainder(at(yaw, 4 * noise) + np.pi, 2 * np.pi) - np.pi,
            "vx": at(v, 20 * noise),
            "vy": at(vy, 20 * noise),
            "yaw_rate": at(r, 40 * noise),
            "throttle": np.interp(t, fine, throttle),
            "steering": np.interp(t, fine, command),
        }
    )


@pytest.fixture(scope="session")
def make_drive() -> Callable[..., pd.DataFrame]:
    """Builds tables of `ideal_drive`."""
    return ideal_drive


@pytest.fixture
def good(make_drive) -> pd.DataFrame:
    """Twenty seconds at 100 Hz with the noise of a motion capture system."""
    return make_drive(noise=2e-4)


@pytest.fixture
def write(tmp_path) -> Callable[..., Path]:
    """Writes a table and returns its path."""

    def write_csv(frame: pd.DataFrame, name: str = "drive.csv") -> Path:
        frame.to_csv(tmp_path / name, index=False)
        return tmp_path / name

    return write_csv
