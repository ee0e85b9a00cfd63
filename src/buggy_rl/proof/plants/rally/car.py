"""The simulated car: one object for a batch of cars, with all motion in the state."""

from collections.abc import Mapping

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Array, Arrays, col, per_car, sum4
from buggy_rl.proof.plants.rally.body import (
    body_energy,
    contact_velocity,
    move_attitude,
    move_plane,
    total_force,
    wheel_loads,
)
from buggy_rl.proof.plants.rally.changes import Changes, constants, floor_grip
from buggy_rl.proof.plants.rally.drivetrain import spin_energy, step_drivetrain
from buggy_rl.proof.plants.rally.steering import (
    HISTORY,
    PERIOD,
    delayed_command,
    push_command,
    step_servo,
    wheel_angles,
)
from buggy_rl.proof.plants.rally.tyre import (
    CELLS,
    advance_bristles,
    bristle_energy,
    bristle_force,
    friction_level,
)
from buggy_rl.proof.plants.rally.unknowns import make_unknowns

_ONES = ("drive", "servo_rate")
_ZEROS = ("rotor_drag", "force_x", "force_y", "moment", "roll_moment", "pitch_moment", "lift")
_ZEROS_WHEEL = ("road", "road_rate", "grade_x", "grade_y", "toe", "resist", "wheel_torque")
_REST = (
    "heave",
    "heave_rate",
    "roll",
    "roll_rate",
    "pitch",
    "pitch_rate",
    "duty",
    "servo",
    "rack",
    "charge",
    "current",
    "clutch_slip",
    "time",
)


class RallyCar:
    """A batch of N independent cars with changes and unknown effects.

    The object never changes after construction; rows never influence one another.

    Args:
        parameters: From `draw_parameters`.
        changes: `{name: {argument: array [N] or float}}`, of `CHANGES`.
        unknown: `{name: size [N] or float}`, of `UNKNOWNS`.
        substeps: Integration steps in one control period (0.01 s).

    Raises:
        ValueError: There is no such change, argument or unknown effect.
    """

    def __init__(
        self,
        parameters: Arrays,
        changes: Changes | None = None,
        unknown: Mapping[str, Array | float] | None = None,
        substeps: int = 10,
    ) -> None:
        self.cars = len(parameters["mass"])
        self.substeps, self.dt = substeps, PERIOD / substeps
        self.constants = constants(parameters, changes or {})
        self._patch = bool(np.any(self.constants["has_patch"]))
        sizes = {name: per_car(size, self.cars) for name, size in (unknown or {}).items()}
        self.unknowns = make_unknowns(sizes, self.constants)

    def start(self, pose: Array, velocity: Array) -> Arrays:
        """State at pose [N, 3] (x, y, yaw) with velocity [N, 3] (vx, vy, yaw rate), rolling."""
        k, n = self.constants, self.cars
        pose = np.broadcast_to(np.asarray(pose, dtype=float), (n, 3))
        velocity = np.broadcast_to(np.asarray(velocity, dtype=float), (n, 3))
        state: Arrays = {name: np.zeros(n) for name in _REST}
        for index, name in enumerate(("x", "y", "yaw")):
            state[name] = pose[:, index].copy()
        for index, name in enumerate(("vx", "vy", "yaw_rate")):
            state[name] = velocity[:, index].copy()
        state["wheel"] = contact_velocity(k, state, np.zeros((n, 4)))[0] / col(k["radius"])
        state["rotor"] = sum4(k["gear_share"] * state["wheel"])
        state["bristle"] = np.zeros((n, 4, 2, CELLS))
        state["history"] = np.tile(np.array([-1.0, 0.0]), (n, HISTORY, 1))
        for effect in self.unknowns:
            state.update(effect.start(state))
        return state

    def step(self, state: Arrays, command: Array) -> Arrays:
        """State one control period (0.01 s) later; command [N, 2] = (throttle, steering)."""
        state = dict(state)
        command = np.broadcast_to(np.asarray(command, dtype=float), (self.cars, 2))
        for effect in self.unknowns:
            command = effect.command(state, command)
        state["history"] = push_command(state["history"], command)
        for index in range(self.substeps):
            self._substep(state, index * self.dt)
        for effect in self.unknowns:
            effect.finish(state)
        return state

    def pose(self, state: Arrays) -> Array:
        """True pose of the centre of gravity (of car and payload), [N, 3]: m, m, rad."""
        return np.stack([state["x"], state["y"], state["yaw"]], axis=1)

    def velocity(self, state: Arrays) -> Array:
        """True velocity of the centre of gravity in the body frame, [N, 3]: m/s, m/s, rad/s."""
        return np.stack([state["vx"], state["vy"], state["yaw_rate"]], axis=1)

    def shown(self, state: Arrays) -> Arrays:
        """{"pose", "velocity"} as a noise-free sensor shows them, with the sensor unknowns."""
        pose, velocity = self.pose(state), self.velocity(state)
        for effect in self.unknowns:
            pose, velocity = effect.show(state, pose, velocity)
        return {"pose": pose, "velocity": velocity}

    def energy(self, state: Arrays) -> Array:
        """Mechanical energy of motion, springs and bristles, J [N], without the unknowns."""
        k = self.constants
        load = wheel_loads(k, state, self._inputs(state))
        return (
            body_energy(k, state)
            + spin_energy(k, state)
            + bristle_energy(k, state["bristle"], load)
        )

    def _inputs(self, state: Arrays) -> Arrays:
        """Neutral values of all quantities that unknown effects may alter."""
        n = self.cars
        inputs: Arrays = {name: np.ones(n) for name in _ONES}
        inputs.update({name: np.zeros(n) for name in _ZEROS})
        inputs.update({name: np.zeros((n, 4)) for name in _ZEROS_WHEEL})
        inputs["grip"] = floor_grip(self.constants, state) if self._patch else np.ones((n, 4))
        inputs["clutch"] = np.full(n, np.inf)
        return inputs

    def _substep(self, state: Arrays, elapsed: float) -> None:
        """One integration step; bristles first, then forces, then motion (semi-implicit)."""
        k, dt = self.constants, self.dt
        inputs = self._inputs(state)
        for effect in self.unknowns:
            effect.before(inputs, state, dt)
        throttle = delayed_command(state["history"], 0, k["throttle_dead_time"], elapsed)
        steer = delayed_command(state["history"], 1, k["steering_dead_time"], elapsed)
        step_servo(k, state, inputs, steer, dt)
        angle = wheel_angles(k, state["rack"], inputs["toe"])
        load, tyre, slip = self._tyres(state, inputs, angle)
        force = total_force(k, state, inputs, tyre, angle, load)
        step_drivetrain(k, state, inputs, throttle, tyre[0], load, dt)
        move_plane(k, state, force[:3], dt)
        move_attitude(k, state, inputs, load, force[3:], dt)
        state["time"] = state["time"] + dt
        self._remember(state, load, tyre, slip, angle, force)

    def _remember(
        self, state: Arrays, load: Array, tyre: tuple, slip: tuple, angle: Array, force: tuple
    ) -> None:
        """Let the unknown effects advance their memory with the signals of the step."""
        mass = self.constants["mass"]
        signals = {
            "load": load,
            "force_x": tyre[0],
            "force_y": tyre[1],
            "slip_x": slip[0],
            "slip_y": slip[1],
            "angle": angle,
            "current": state["current"],
            "ax": force[0] / mass,
            "ay": force[1] / mass,
        }
        for effect in self.unknowns:
            effect.after(state, signals, self.dt)

    def _tyres(self, state: Arrays, inputs: Arrays, angle: Array) -> tuple:
        """Loads, tyre forces and sliding velocities; writes the bristles."""
        k = self.constants
        load = wheel_loads(k, state, inputs)
        rolling = state["wheel"] * col(k["radius"])
        along, across = contact_velocity(k, state, angle)
        slip = (along - rolling, across, np.zeros((self.cars, 4)) + col(state["yaw_rate"]))
        slide = np.sqrt(slip[0] * slip[0] + slip[1] * slip[1])
        level = friction_level(k, load, slide, inputs["grip"])
        bristle = advance_bristles(k, state["bristle"], slip, rolling, level, self.dt)
        state["bristle"] = bristle
        return load, bristle_force(k, bristle, slip, rolling, load), slip
