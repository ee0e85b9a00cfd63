"""Where and in what situation a simulator errs: short rollouts, each instant charged its own."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from buggy_rl.diagnosis.case import Case
from buggy_rl.diagnosis.locate import SHORT, features

LARGE = 50.0  # times the noise, as which a change of a gap counts at most


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
    cut = case.cut
    player = replace(case.given, every=max(1, round(SHORT / cut.dt / 3)))
    gap = player.play(cut, {})[0].double()[..., 3:]  # (N, K, 3)
    change = torch.cat([torch.zeros_like(gap[:, :1]), gap], 1).diff(dim=1)
    change = (change / case.likelihood.noise[3:]).nan_to_num(LARGE).clamp(-LARGE, LARGE)
    size = (change.square().mean(-1) / 2).sqrt()  # a difference of two readings has twice the noise
    seen = features(cut, player.instants(cut))
    columns = {n: seen[n].flatten().numpy() for n in ("x", "y", "vx", "steering")}
    return Errors(size=size.flatten().numpy(), **columns)
