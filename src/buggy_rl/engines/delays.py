"""Dead time and first-order lag of a command that is constant over a control period."""

import torch
from torch import Tensor

SLOWEST_LAG = 1e-6  # [s] stands for no lag, where the formula divides by the time constant


def dead_time_weights(dead_time: Tensor, dt: float, length: int) -> Tensor:
    """Weights of the last commands in the mean command that arrives during a control period.

    The commands are a staircase u_k; late by tau, its mean over a period is
    sum_j max(0, 1 - |j - tau / dt|) u_{k-j}: exact, and continuous in tau.

    Args:
        dead_time: [*] tau [s].
        dt: Control period [s].
        length: How many commands there are, the present one included.

    Returns:
        [*, length] adding up to 1.
    """
    age = torch.arange(length, dtype=dead_time.dtype, device=dead_time.device)
    return (1 - (age - dead_time.unsqueeze(-1) / dt).abs()).clamp_min(0)


def lag_decay(time_constant: Tensor, start: float, end: float) -> Tensor:
    """Mean remaining share of a step over start..end [s] behind a first-order lag.

    y(t) = u + (y(0) - u) exp(-t / T), so its mean is u + (y(0) - u) d with
    d = T (exp(-start / T) - exp(-end / T)) / (end - start).

    Args:
        time_constant: [*] T [s]; 0 is no lag.
        start: Start of the interval [s].
        end: Its end [s]; when equal to `start`, the value at that moment.

    Returns:
        [*] d in 0..1.
    """
    T = time_constant.clamp_min(SLOWEST_LAG)
    if start == end:
        return torch.exp(-start / T)
    return torch.exp(-start / T) * -torch.expm1((start - end) / T) * T / (end - start)
