"""Gradients of a surrogate beside finite differences of its simulator.

    python -m benchmarks.surrogate_gradient simulator=SURROGATE.yaml

Cars drive for a while by slow random commands; then throttle and steering are changed by a constant
for 10 and 32 steps. For each number of the motion at the end: the cosine between the gradients of
all cars and the central differences, and the ratio of their lengths.
"""

from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from buggy_rl.core import keys
from buggy_rl.core.config import from_command_line, run
from buggy_rl.task.env import make_simulator

CARS, BEFORE, HORIZONS = 64, 120, (10, 32)
CHANGE = 0.05  # [-] of a command, for the differences
NUMBERS = ("x", "y", "yaw", "vx", "vy", "yaw_rate")


@dataclass(frozen=True)
class GradientConfig:
    """What is compared."""

    simulator: str = "runs/surrogate.yaml"
    """A file with the engine `surrogate`."""
    seed: int = 0
    """Of the commands."""


def main() -> None:
    """Prints a row for each command, number and horizon."""
    config = from_command_line(__doc__, "benchmarks.surrogate_gradient:GradientConfig")
    torch.set_num_threads(1)
    env, commands = make_simulator(config.simulator, CARS), slow_commands(config.seed)
    with torch.no_grad():
        begun = followed(env, env.reset(), commands[:BEFORE])
    for steps in HORIZONS:
        part = commands[BEFORE : BEFORE + steps]
        given = torch.zeros(CARS, 2, requires_grad=True)
        end = motion(followed(env, begun, part + given))
        slopes = [torch.autograd.grad(n.sum(), given, retain_graph=True)[0] for n in end.unbind(-1)]
        for channel, command in enumerate(("throttle", "steering")):
            by_steps = differences(env, begun, part, channel)
            for number, slope, other in zip(NUMBERS, slopes, by_steps.unbind(-1), strict=True):
                print(f"{steps} {command} {number} {compared(slope[:, channel], other)}")


def slow_commands(seed: int) -> Tensor:
    """Commands [steps, cars, 2]: constant throttle, steering by a slow sine."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        throttle, size, phase = torch.rand(3, CARS)
    time = 0.04 * torch.arange(BEFORE + max(HORIZONS))[:, None]
    steering = (1.2 * size - 0.6) * torch.cos(time + 6.28 * phase)
    return torch.stack([(-0.45 + 0.25 * throttle).expand_as(steering), steering], -1)


def followed(env: EnvBase, state: TensorDictBase, commands: Tensor) -> TensorDictBase:
    """The state after commands [steps, cars, 2]."""
    state = state.copy()
    for command in commands:
        state = env.step(state.set(keys.ACTION, command))["next"]
    return state


def motion(state: TensorDictBase) -> Tensor:
    """Pose and velocity [cars, 6]."""
    return torch.cat([state[keys.POSE], state[keys.VELOCITY]], -1)


@torch.no_grad()
def differences(env: EnvBase, begun: TensorDictBase, commands: Tensor, channel: int) -> Tensor:
    """Central differences [cars, 6] of the motion by a constant change of one command."""
    change = torch.zeros(2)
    change[channel] = CHANGE
    ends = [motion(followed(env, begun, commands + sign * change)) for sign in (1, -1)]
    return (ends[0] - ends[1]) / (2 * CHANGE)


def compared(slope: Tensor, other: Tensor) -> str:
    """Cosine, ratio of lengths and rms difference quotient of all cars."""
    cosine = torch.nn.functional.cosine_similarity(slope, other, dim=0)
    ratio, rms = slope.norm() / other.norm(), other.square().mean().sqrt()
    return f"cosine {cosine:.2f} ratio {ratio:.2f} rms {rms:.3f}"


if __name__ == "__main__":
    run(main)
