"""A network that learns the acceleration which the steps of a simulator lack."""

import torch
from torch import Tensor

from buggy_rl.effects.motion.base import Motion
from buggy_rl.effects.residual import ResidualNetwork, residual_inputs
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import Segments
from buggy_rl.vehicle import VehicleDimensions, shift_velocity

BOUND = 3.0  # [root mean squares of the target] beyond which no correction goes
SPANS = (1, 20)  # [rows] over which accelerations are compared
STEPS, BATCH = 500, 24  # updates, and segments in each
LEARNING_RATE, DECAY = 5e-3, 1e-2


@torch.no_grad()
def lacking_acceleration(simulation: Simulation, segments: Segments) -> tuple[Tensor, Tensor]:
    """What each step of the engine lacks to end where the measured motion went.

    a = (v_measured - v_engine) / dt at the centre of gravity, the measured motion imposed at every
    row so that latent states are what they would be.

    Returns:
        The network's inputs [N, H, 8] and the acceleration [N, H, 3].
    """
    arm = VehicleDimensions().sensor_to_cg
    pose, velocity, dt = segments.smooth_pose, segments.smooth_velocity, segments.dt
    inputs, lacking = [], []
    for row, _, after in simulation.single_steps(segments):
        both = torch.stack([velocity[:, row], velocity[:, row + 1], after[:, 3:]])
        before, wanted, reached = shift_velocity(both, -arm).unbind(0)
        action = segments.action[:, row].clamp(-1, 1)
        motion = Motion(pose[:, row], before, reached, action, dt)
        inputs.append(residual_inputs(motion))
        lacking.append((wanted - reached) / dt)
    return torch.stack(inputs, 1), torch.stack(lacking, 1)


def trained(inputs: Tensor, lacking: Tensor, seed: int) -> ResidualNetwork:
    """A network fitted to accelerations row by row and to their means over `SPANS` rows.

    The means bring out what is small but lasts, which decides where a rollout ends; row by row the
    noise of a derivative hides it.

    Args:
        inputs: [N, H, 8].
        lacking: [N, H, 3].
        seed: Same seed, same network.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = ResidualNetwork()
        network.mean.copy_(inputs.flatten(0, 1).mean(0))
        network.scale.copy_(inputs.flatten(0, 1).std(0).clamp_min(1e-3))
        network.bound.copy_(BOUND * lacking.square().mean((0, 1)).sqrt().clamp_min(1e-3))
        size = [_spans(lacking, span).square().mean((0, 1)).clamp_min(1e-6) for span in SPANS]
        optimiser = torch.optim.AdamW(network.parameters(), LEARNING_RATE, weight_decay=DECAY)
        for _ in range(STEPS):
            rows = torch.randperm(len(inputs))[:BATCH]
            error = network(inputs[rows]) - lacking[rows]
            parts = [
                (_spans(error, n).square() / s).mean() for n, s in zip(SPANS, size, strict=True)
            ]
            optimiser.zero_grad()
            torch.stack(parts).sum().backward()
            optimiser.step()
    return network.eval().requires_grad_(False)


def _spans(signal: Tensor, rows: int) -> Tensor:
    """Means [N, H // rows, C] of a signal [N, H, C] over spans of rows; the rest is left out."""
    count = signal.shape[1] // rows
    return signal[:, : count * rows].unflatten(1, (count, rows)).mean(2)
