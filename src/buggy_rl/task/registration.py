"""Registers the environment with Gymnasium, by the names of its classes: none is imported."""

NAME = "buggy_rl/Waypoints-v0"


def register() -> None:
    """Registers `NAME`, one car and many, unless it is registered already."""
    from gymnasium.envs import registration

    if NAME not in registration.registry:
        registration.register(
            NAME,
            entry_point="buggy_rl.task.gym:WaypointsEnv",
            vector_entry_point="buggy_rl.task.gym_vector:WaypointsVectorEnv",
        )
