"""Drive helpers of the tests."""

import numpy as np

from buggy_rl.proof.plants.rally.car import RallyCar
from buggy_rl.proof.plants.rally.parameters import draw_parameters

OFF = np.array([-1.0, 0.0])


def parameters(cars: int, seed: int = 5) -> dict[str, np.ndarray]:
    """Drawn parameters of a batch."""
    return draw_parameters(np.random.default_rng(seed), cars)


def same(cars: int, seed: int = 5) -> dict[str, np.ndarray]:
    """One drawn car, repeated."""
    return {key: np.repeat(value, cars, axis=0) for key, value in parameters(1, seed).items()}


def weave(steps: int, throttle: float = 0.3, steer: float = 0.55) -> np.ndarray:
    """Commands [steps, 2]: throttle in pulls, steering as a slow weave."""
    time = 0.01 * np.arange(steps)
    pull = throttle + 0.5 * np.sign(np.sin(2 * np.pi * 0.9 * time + 0.3))
    return np.stack([pull, steer * np.sin(2 * np.pi * 1.0 * time)], axis=1)


def drive(car: RallyCar, commands: np.ndarray, speed: float = 2.5) -> dict[str, np.ndarray]:
    """Drive from rest at the origin or a given speed; arrays [steps + 1, N, 3]."""
    state = car.start(np.zeros(3), np.array([speed, 0.0, 0.0]))
    states = [state]
    for command in commands:
        state = car.step(state, command)
        states.append(state)
    shown = [car.shown(state) for state in states]
    return {
        "pose": np.array([car.pose(state) for state in states]),
        "velocity": np.array([car.velocity(state) for state in states]),
        "shown_pose": np.array([one["pose"] for one in shown]),
        "shown_velocity": np.array([one["velocity"] for one in shown]),
        "last": state,
    }


def reckoned(result: dict[str, np.ndarray]) -> np.ndarray:
    """Place [steps + 1, N, 2] from shown velocity and shown heading by adding up."""
    yaw, velocity = result["shown_pose"][..., 2], result["shown_velocity"]
    cosine, sine = np.cos(yaw), np.sin(yaw)
    world = np.stack(
        [
            cosine * velocity[..., 0] - sine * velocity[..., 1],
            sine * velocity[..., 0] + cosine * velocity[..., 1],
        ],
        axis=-1,
    )
    return np.cumsum(0.01 * world, axis=0)


def moved(first: dict[str, np.ndarray], second: dict[str, np.ndarray]) -> np.ndarray:
    """Greatest distance between two shown drives in mm [N], by pose or by reckoned place."""
    pose = first["shown_pose"][..., :2] - second["shown_pose"][..., :2]
    place = reckoned(first) - reckoned(second)
    both = [np.sqrt((part**2).sum(-1)).max(axis=0) for part in (pose, place)]
    return 1000.0 * np.maximum(both[0], both[1])
