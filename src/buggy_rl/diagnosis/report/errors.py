"""Where and in what situation a simulator errs: short rollouts, each instant charged its own."""

from dataclasses import dataclass

import numpy as np

from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.localisation import charged, features


@dataclass(frozen=True)
class Errors:
    """Of M instants."""

    size: np.ndarray
    """[M] how far the velocities' gap changed since the instant before, in units of the noise."""
    x: np.ndarray
    """[M] m in the room."""
    y: np.ndarray
    vx: np.ndarray
    """[M] m/s"""
    steering: np.ndarray
    """[M] command."""


def errors(case: Case) -> Errors:
    """Of the simulator as given, on all stretches; charged as `locate` does."""
    change, instants = charged(case.given, case.cut, case.likelihood.noise)
    size = (change.square().mean(-1) / 2).sqrt()  # a difference of two readings has twice the noise
    seen = features(case.cut, instants)
    columns = {n: seen[n].flatten().numpy() for n in ("x", "y", "vx", "steering")}
    return Errors(size=size.flatten().numpy(), **columns)
