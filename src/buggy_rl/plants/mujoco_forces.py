"""Forces of the faults on the MuJoCo car in one substep.

The engine's tyre forces are those at the end of the substep. So the tyre law gets the motion as the
faults' forces will have changed it, and steady states are exact with these forces too.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from buggy_rl.engines.mujoco.car import Car
from buggy_rl.engines.mujoco.forces import STOPPING_SPEED, Forces, Motion, Wheels, read_motion
from buggy_rl.engines.mujoco.weights import DRIVELINE_INERTIA, WHEEL_SPIN_INERTIA
from buggy_rl.plants.faults import Faults
from buggy_rl.plants.surroundings import PUSHES, patch_grip, push, turned_back
from buggy_rl.vehicle import GRAVITY

SLOWEST_SHAFT = 0.05  # [m/s] least tread speed of the power limit; chosen


class FaultyForces(Forces):
    """Forces of cars with faults.

    Args:
        car: The model.
        values: Parameter name -> [1] or [n], with the faults.
        faults: Of the car.
    """

    def __init__(self, car: Car, values: Mapping[str, NDArray], faults: Faults) -> None:
        super().__init__(car, values)
        self.faults = faults
        self._floor_grip = self._grip
        wheels = (4 * WHEEL_SPIN_INERTIA + 2 * DRIVELINE_INERTIA) / self.radius**2  # [kg]
        mass = values["mass"]
        self._rolling_share = 1.0 + wheels / mass
        self._bare_mass = mass / faults["payload.mass_ratio"]
        self._half_track = 0.5 * car.dimensions.track_width
        in_front = 1.0 - values["cg_to_front_axle"] / car.dimensions.wheelbase
        self._axle_mass = (mass * in_front, mass * (1.0 - in_front))
        self._pushed = push(
            faults,
            self._rolling_share,
            mass,
            values["yaw_inertia"],
            self._half_track,
            rear_load=GRAVITY * self._axle_mass[1],
        )
        self._pushes = bool((PUSHES | {"torque_steer"}) & faults.active)
        self._turns = bool({"understeer", "dive_steer"} & faults.active)
        self._pulled = 0.0  # yaw acceleration of the substep by the motor's force [rad/s^2]
        self._slope = (faults["floor_slope.along_x"], faults["floor_slope.along_y"])

    def motor_force(self, qvel: NDArray, drive: NDArray) -> NDArray:
        """Force of the motor [n] [N] at a drive [n] in 0..1."""
        loss = self.values["drive_speed_loss"] * self._tread_speed(qvel)
        return drive * (self.values["drive_force"] - loss)

    def apply(self, qpos, qvel, xfrc_applied, qfrc_applied, steering_angle, drive) -> None:
        """Writes the forces, with those of the faults added."""
        if "motor_power_limit" in self.faults:
            drive = self._limited(qvel, drive)
        if "torque_steer" in self.faults:
            moment = -self.faults["torque_steer.offset"] * self.motor_force(qvel, drive)
            self._pulled = moment / self.values["yaw_inertia"]
        if self._turns:
            motor = self.motor_force(qvel, drive)
            steering_angle = steering_angle + self._turned(read_motion(qpos, qvel), motor)
        super().apply(qpos, qvel, xfrc_applied, qfrc_applied, steering_angle, drive)
        if self._pushes:
            self._push(read_motion(qpos, qvel), xfrc_applied)
        if "cornering_drag" in self.faults:
            motion = read_motion(qpos, qvel)
            self._along(motion, -self._scrub * np.tanh(motion.vx / STOPPING_SPEED), xfrc_applied)
        if "steering_drag" in self.faults:
            motion = read_motion(qpos, qvel)
            drag = self.faults["steering_drag.per_angle"] * np.abs(steering_angle)
            drag = drag * self.values["mass"] * self._rolling_share
            self._along(motion, -drag * np.tanh(motion.vx / STOPPING_SPEED), xfrc_applied)

    def tyre_forces(
        self,
        qpos: NDArray,
        qvel: NDArray,
        motion: Motion,
        wheels: Wheels,
        resistance: NDArray,
    ) -> tuple[NDArray, NDArray]:
        """Forces [4, n] along and across the heading, with the friction of each wheel's place."""
        if "grip_patch" in self.faults:
            x, y = self._wheel_places(qpos, motion)
            self._grip = self._floor_grip * patch_grip(self.faults, x, y)
        if self._pushes or "floor_slope" in self.faults:
            motion = self._end_of_step(motion)
        fx, fy = super().tyre_forces(qpos, qvel, motion, wheels, resistance)
        if "cornering_drag" in self.faults:
            front, rear = self._axle_mass
            axles = (fy[0] + fy[1]) ** 2 / front + (fy[2] + fy[3]) ** 2 / rear
            self._scrub = self.faults["cornering_drag.coefficient"] * self._rolling_share * axles
        return fx, fy

    def _resistance(self, speed: NDArray) -> NDArray:
        resistance = super()._resistance(speed)
        if "rolling_resistance" in self.faults or "viscous_drag" in self.faults:
            dry = self.faults["rolling_resistance.deceleration"] * np.tanh(speed / STOPPING_SPEED)
            slowing = dry + self.faults["viscous_drag.rate"] * speed  # [m/s^2]
            resistance = resistance - self.values["mass"] * self._rolling_share * slowing
        return resistance

    def _accelerations(self, motion: Motion):
        ax, ay, turning = self._pushed(
            motion.cos, motion.sin, motion.vx, motion.vy, motion.yaw_rate
        )
        return ax, ay, turning + self._pulled

    def _turned(self, motion: Motion, motor: NDArray) -> NDArray:
        """Angle [n] [rad] of the front wheels beside the servo's."""
        moved = self.values["mass"] * self._rolling_share
        forward = (motor + self._resistance(motion.vx)) / moved
        return turned_back(self.faults, motion.vx, motion.yaw_rate, forward)

    def _end_of_step(self, motion: Motion) -> Motion:
        """The motion after the faults' forces of this substep, at the sensor."""
        ax, ay, turning = self._accelerations(motion)
        x, y = self._slope
        ax, ay = ax + motion.cos * x + motion.sin * y, ay + motion.cos * y - motion.sin * x
        return motion._replace(
            vx=motion.vx + self.dt * ax,
            vy=motion.vy + self.dt * (ay - self._cg_x * turning),
            yaw_rate=motion.yaw_rate + self.dt * turning,
        )

    def _push(self, motion: Motion, xfrc_applied: NDArray) -> None:
        mass, inertia = self.values["mass"], self.values["yaw_inertia"]
        ax, ay, turning = self._accelerations(motion)
        self._along(motion, mass * ax, xfrc_applied)
        body = xfrc_applied[:, self.car.chassis]
        body[:, 0] -= motion.sin * mass * ay
        body[:, 1] += motion.cos * mass * ay
        # A bent rear axle: opposite forces on its hubs.
        damping = -self.faults["yaw_damping.rate"] * motion.yaw_rate
        couple = (turning - damping) * inertia / (2.0 * self._half_track)
        for wheel, side in zip(self.car.wheel_bodies[2:], (-1.0, 1.0), strict=True):
            xfrc_applied[:, wheel, 0] += side * couple * motion.cos
            xfrc_applied[:, wheel, 1] += side * couple * motion.sin
        body[:, 5] = damping * inertia

    def _along(self, motion: Motion, force: NDArray, xfrc_applied: NDArray) -> None:
        xfrc_applied[:, self.car.chassis, 0] += force * motion.cos
        xfrc_applied[:, self.car.chassis, 1] += force * motion.sin

    def _wheel_places(self, qpos: NDArray, motion: Motion) -> tuple[NDArray, NDArray]:
        x, y = self.car.hub_x, self.car.hub_y  # (4, 1)
        return (
            qpos[:, 0] + motion.cos * x - motion.sin * y,
            qpos[:, 1] + motion.sin * x + motion.cos * y,
        )

    def _tread_speed(self, qvel: NDArray) -> NDArray:
        return 0.5 * self.radius * qvel[:, self.car.spin[2:]].sum(1)

    def _limited(self, qvel: NDArray, drive: NDArray) -> NDArray:
        """Drive [n] at which d (F - c u) u <= P, u the tread's speed."""
        speed = np.maximum(self._tread_speed(qvel), SLOWEST_SHAFT)
        force = self.values["drive_force"] - self.values["drive_speed_loss"] * speed
        limit = self.faults["motor_power_limit.power_per_mass"] * self._bare_mass
        return np.minimum(drive, limit / np.maximum(force * speed, 1e-6))
