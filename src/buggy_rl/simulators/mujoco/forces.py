"""Forces on the car in one physics substep, written into MuJoCo's applied forces.

Tyres are stiff: at 1 m/s a wheel's spin settles in half a millisecond and the yaw rate in five. So
tyre forces are those at the *end* of the substep, by one Newton step of the planar car with its
four wheel spins (linearly implicit Euler): steady states are those of the tyre law, and substeps
of several milliseconds are stable down to rest.

Arrays are [n] over environments and [4, n] over wheels and environments, of NumPy or PyTorch: the
same text steps MuJoCo on the CPU and on a GPU.
"""

from collections.abc import Mapping
from types import ModuleType
from typing import Any, NamedTuple

from array_api_compat import array_namespace

from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.core.vehicle import GRAVITY
from buggy_rl.simulators.mujoco.actuators import SHARES, STOPS, Drivetrain
from buggy_rl.simulators.mujoco.arrays import Array, column_like, solve3, stacked
from buggy_rl.simulators.mujoco.car import CompiledCar
from buggy_rl.simulators.mujoco.floor import Floor
from buggy_rl.simulators.mujoco.weights import spring_reference

SLIP_STIFFNESS = 12.0  # [-] longitudinal force over load and slip ratio; chosen, not measured
SLOWEST_ROLLING = 0.1  # [m/s] least speed slip is divided by: at rest a tyre is a damper; chosen
TINY = 1e-9  # [-] slip below which it has no direction


class TyreForce(NamedTuple):
    """Forces on the car and their derivatives by the slip velocity; all [4, n]."""

    fx: Array
    """[N]"""
    fy: Array
    """[N]"""
    fx_sx: Array
    """d fx / d(slip velocity along x) [N s/m]"""
    fx_sy: Array
    fy_sx: Array
    fy_sy: Array


class Tyre(NamedTuple):
    """Parameters of a tyre, each a number or [4, n]."""

    grip: Any
    """mu [-]."""
    cornering: Any
    """c, lateral force over load and slip angle at small slip [1/rad]."""
    shape: Any
    """C [-], 1 to 2."""


def tyre_force(slip_x: Array, slip_y: Array, rolling: Array, load: Array, tyre: Tyre) -> TyreForce:
    """Combined-slip tyre force, Pacejka's magic formula.

    s = (k_x kappa, c tan(-alpha)) / mu,  F = mu F_z sin(C atan(|s| / C)) s / |s|, with the slip
    ratio kappa = slip_x / |v| and the slip angle tan(-alpha) = slip_y / |v|. So |F| <= mu F_z
    always, and at small slip angles F_y = -c F_z alpha at every speed above `SLOWEST_ROLLING`.
    With C = 1 the force tends to mu F_z, F = mu F_z s / sqrt(1 + |s|^2); with C > 1 it peaks at
    |s| = C tan(pi / 2C) and falls beyond.

    Source: Pacejka 2012, Tire and Vehicle Dynamics, 3rd ed., sec. 4.3, without curvature factor.

    Args:
        slip_x: Circumference minus patch speed, omega r - v_x [m/s].
        slip_y: Minus the patch's sideways speed, -v_y [m/s].
        rolling: v_x of the patch [m/s].
        load: F_z [N], not negative.
        tyre: Its parameters.
    """
    xp = array_namespace(slip_x)
    grip, cornering, shape = tyre
    per_speed = 1.0 / xp.maximum(xp.abs(rolling), SLOWEST_ROLLING)
    bx = (SLIP_STIFFNESS * per_speed) / grip  # (4, n)
    by = cornering * per_speed / grip
    sx, sy = bx * slip_x, by * slip_y
    slip = xp.maximum(xp.sqrt(sx * sx + sy * sy), TINY)
    angle = shape * xp.atan(slip / shape)
    most = grip * load
    secant = most * xp.sin(angle) / slip
    # Beyond the peak the slope is taken as 0: a negative one would make the Newton step diverge.
    slope = most * xp.maximum(xp.cos(angle), 0.0) / (1.0 + (slip / shape) ** 2)
    # dF/ds = secant (1 - n n^T) + slope n n^T,  n = s / |s|
    nx, ny, over = sx / slip, sy / slip, secant - slope
    cross = -over * nx * ny
    return TyreForce(
        secant * sx,
        secant * sy,
        fx_sx=(secant - over * nx * nx) * bx,
        fx_sy=cross * by,
        fy_sx=cross * bx,
        fy_sy=(secant - over * ny * ny) * by,
    )


STOPPING_SPEED = 0.1  # [m/s] speed at which rolling resistance is at tanh(1) = 76 %; chosen


class ChassisMotion(NamedTuple):
    """Planar motion of the chassis, in axes along and across its heading."""

    cos: Array
    """Cosine of the heading, [n]."""
    sin: Array
    vx: Array
    """Velocity of the body frame [m/s]."""
    vy: Array
    yaw_rate: Array
    """Yaw rate about the vertical [rad/s]."""


class WheelState(NamedTuple):
    """Spin, steering and motor torque of the wheels."""

    spin: Array
    """[4, n] rad/s."""
    steering_angle: Array
    """[n] of the front wheels [rad]."""
    torque: Array
    """[4, n] of motor and brake [N m]."""
    slope: Array
    """[4, n] its derivative by the spin [N m s]."""


def read_motion(qpos: Array, qvel: Array) -> ChassisMotion:
    """Heading and velocities of chassis on a free joint, qpos [n, nq], qvel [n, nv].

    The linear part of a free joint's qvel is in the world frame, the angular part in the body
    frame.
    """
    xp = array_namespace(qpos)
    w, x, y, z = qpos[:, 3:7].T
    ahead_x, ahead_y = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z)  # the body's x axis
    level = 1.0 / xp.sqrt(ahead_x**2 + ahead_y**2)
    cos, sin = ahead_x * level, ahead_y * level
    p, q, r = qvel[:, 3:6].T
    yaw_rate = 2 * (x * z - w * y) * p + 2 * (y * z + w * x) * q + (1 - 2 * (x * x + y * y)) * r
    vx, vy = qvel[:, 0], qvel[:, 1]
    return ChassisMotion(cos, sin, cos * vx + sin * vy, cos * vy - sin * vx, yaw_rate)


class AppliedForces(NamedTuple):
    """Forces on the car in a substep; those in the world frame are [N]."""

    along_x: Array
    """[4, n] of the tyres at their patches."""
    along_y: Array
    push: Array
    """[4, n] of the floor, upwards."""
    resistance: tuple[Array, Array]
    """[n] x and y, at the chassis's centre of gravity."""
    torque: Array
    """[4, n] about the axles [N m]."""


class Forces:
    """Drive, resistance and, with explicit tyres, forces of tyres and floor of n environments.

    Args:
        car: Compiled model.
        values: Parameter name -> [1] or [n].
        command: What the first command is.
    """

    def __init__(
        self,
        car: CompiledCar,
        values: Mapping[str, Array],
        command: LongitudinalCommand = ONE_WAY,
    ) -> None:
        self.car = car = car.beside(values["mass"])
        self.values = values
        self.radius = car.dimensions.wheel_radius
        self.dt = car.timestep
        front, rear = ("front", "front"), ("rear", "rear")
        self._grip = _per_wheel(values, "grip", front + rear)
        self._cornering = _per_wheel(values, "cornering_stiffness", front + rear)
        self._weights = weights = car.weights
        self._spring_reference = spring_reference(weights, car.dimensions.wheelbase, values)
        ahead = car.dimensions.cg_to_front_axle - car.dimensions.sensor_to_cg
        self._cg_x = ahead - values["cg_to_front_axle"]  # of the centre of gravity, body frame
        self._arm_x = car.hub_x - self._cg_x
        self.floor = Floor(car)
        driveline = [weights.driveline_inertia if share else 0.0 for share in SHARES[car.drive]]
        self.drivetrain = Drivetrain(values, self.radius, command, car.drive)
        spin_inertia = [weights.spin_inertia + wheel for wheel in driveline]
        self._spin_inertia = column_like(spin_inertia, values["mass"])
        first, last = int(car.wheel_bodies[0]), int(car.wheel_bodies[-1])
        self._wheel_bodies = slice(first, last + 1)

    @property
    def _xp(self) -> ModuleType:  # not kept: a module cannot be copied with the engine
        return array_namespace(self._spin_inertia)

    def apply(
        self,
        qpos: Array,
        qvel: Array,
        xfrc_applied: Array,
        qfrc_applied: Array,
        steering_angle: Array,
        drive: Array,
    ) -> None:
        """Sets the steering and writes the forces for the next substep.

        Args:
            qpos: [n, nq]; the steering hinges are set to the angle (a stiff servo).
            qvel: [n, nv].
            xfrc_applied: [n, nbody, 6] world frame, written for chassis and wheels.
            qfrc_applied: [n, nv] written for the wheels.
            steering_angle: [n] rad.
            drive: [n] in 0..1, or -1..1 of a two-way command.
        """
        car = self.car
        qpos[:, car.steer + 1] = steering_angle[:, None]
        qvel[:, car.steer] = 0.0
        forces = self.applied(qpos, qvel, steering_angle, drive)
        qfrc_applied[:, car.spin] = forces.torque.T
        xfrc_applied[:, car.chassis, 0], xfrc_applied[:, car.chassis, 1] = forces.resistance
        if car.tyres == "contact":
            return
        x, y = forces.along_x, forces.along_y
        # At the patch, a radius below the hub: F = (x, y, N) and M = (0, 0, -r) x F.
        wrench = xfrc_applied[:, self._wheel_bodies]  # (n, 4, 6)
        wrench[..., 0], wrench[..., 1], wrench[..., 2] = x.T, y.T, forces.push.T
        wrench[..., 3], wrench[..., 4] = self.radius * y.T, -self.radius * x.T

    def applied(
        self, qpos: Array, qvel: Array, steering_angle: Array, drive: Array
    ) -> AppliedForces:
        """The forces of the next substep; those of tyres and floor are 0 where MuJoCo finds them.

        Args: as of `apply`.
        """
        car = self.car
        motion = read_motion(qpos, qvel)
        spin = qvel.T[car.spin]
        torque, slope = self.drivetrain.torques(spin, motion.vx, drive)
        brakes = self.drivetrain.brakes(motion.vx, drive)
        if brakes is not None:
            torque, slope = self._braked(torque, slope, brakes, spin)
        resistance = self._resistance(motion.vx)
        against = (resistance * motion.cos, resistance * motion.sin)
        if car.tyres == "contact":
            none = self._xp.zeros_like(spin)
            return AppliedForces(none, none, none, against, torque)
        wheels = WheelState(spin, steering_angle, torque, slope)
        fx, fy = self.tyre_forces(qpos, qvel, motion, wheels, resistance)
        if brakes is not None:
            torque = self._at_the_end(wheels, fx, fy)
        return AppliedForces(
            motion.cos * fx - motion.sin * fy,
            motion.sin * fx + motion.cos * fy,
            self.floor.push(qpos, qvel, self._carried(qpos, qvel)),
            against,
            torque,
        )

    def _braked(
        self, torque: Array, slope: Array, brakes: Array, spin: Array
    ) -> tuple[Array, Array]:
        """Torque and slope [4, n] with brakes of at most `brakes` [4, n] [N m] against the spin."""
        if self.car.tyres == "contact":  # MuJoCo takes the torque at the start of the substep
            stops = self._xp.abs(spin) * self._spin_inertia / self.dt
            return torque - self._xp.sign(spin) * self._xp.minimum(brakes, stops), slope
        share = (self.radius * spin / STOPS).clip(-1.0, 1.0)
        steep = (self._xp.abs(share) < 1.0) * (self.radius / STOPS)
        return torque - brakes * share, slope - brakes * steep

    def _at_the_end(self, wheels: WheelState, fx: Array, fy: Array) -> Array:
        """Torque [4, n] [N m] at the end of the substep, for tyre forces in body axes [4, n].

        T' = T + dT/domega domega,  (I - dt dT/domega) domega = dt (T - r f): a brake stops a wheel
        and never turns it back.
        """
        cos, sin = self._xp.cos(wheels.steering_angle), self._xp.sin(wheels.steering_angle)
        along = self._xp.concat([cos * fx[:2] + sin * fy[:2], fx[2:]])
        pull = wheels.torque - self.radius * along
        change = self.dt / (self._spin_inertia - self.dt * wheels.slope) * pull
        return wheels.torque + wheels.slope * change

    def _resistance(self, speed: Array) -> Array:
        """Force along the heading [N]: -(F_r tanh(v / v_s) + c v + k v |v|)."""
        rolling = self.values["rolling_resistance"] * self._xp.tanh(speed / STOPPING_SPEED)
        drag = self.values["viscous_drag"] + self.values["quadratic_drag"] * self._xp.abs(speed)
        return -(rolling + drag * speed)

    def loads(self, qpos: Array, qvel: Array) -> Array:
        """Load [4, n] of each tyre in the tyre law [N], not negative."""
        return self._xp.maximum(self._carried(qpos, qvel), 0.0)

    def _carried(self, qpos: Array, qvel: Array) -> Array:
        """Force [4, n] of spring and damper, and the wheel's weight [N]."""
        slide, weights = self.car.slide, self._weights
        squeeze = qpos[:, slide + 1].T - self._spring_reference
        strut = weights.spring_rate * squeeze + weights.spring_damping * qvel[:, slide].T
        return strut + weights.wheel_mass * GRAVITY

    def tyre_forces(
        self,
        qpos: Array,
        qvel: Array,
        motion: ChassisMotion,
        wheels: WheelState,
        resistance: Array,
    ) -> tuple[Array, Array]:
        """Forces [4, n] along and across the heading at the end of the substep."""
        load = self.loads(qpos, qvel)
        # Slip of the planar car: roll and pitch rates are left out.
        patch_x = motion.vx - motion.yaw_rate * self.car.hub_y  # (4, n)
        patch_y = motion.vy + motion.yaw_rate * self.car.hub_x
        cos, sin = self._xp.ones_like(load), self._xp.zeros_like(load)
        cos[:2], sin[:2] = self._xp.cos(wheels.steering_angle), self._xp.sin(wheels.steering_angle)
        rolling = cos * patch_x + sin * patch_y  # wheel axes
        sideways = cos * patch_y - sin * patch_x
        slip_x = wheels.spin * self.radius - rolling
        shape = self.values["tyre_shape"]
        tyre = Tyre(self._grip, self._cornering, shape)
        force = tyre_force(slip_x, -sideways, rolling, load, tyre)
        fx, fy = self._implicit(force, motion, (cos, sin), wheels, resistance)
        # The linearised force may leave the friction circle: it is scaled back to it.
        limit = self._grip * load
        shrink = self._xp.minimum(limit / self._xp.maximum(self._xp.hypot(fx, fy), 1e-12), 1.0)
        fx, fy = fx * shrink, fy * shrink
        return cos * fx - sin * fy, sin * fx + cos * fy

    def _implicit(
        self,
        force: TyreForce,
        motion: ChassisMotion,
        direction: tuple[Array, Array],
        wheels: WheelState,
        resistance: Array,
    ) -> tuple[Array, Array]:
        """Tyre forces [4, n] in wheel axes at the end of the substep.

        M dv / dt = sum_i A_i^T f_i' + Q,  f_i' = f_i + J_i (r domega_i e_x - A_i dv),
        I domega_i / dt = T_i - r f_x,i',  solved for dv = (dvx, dvy, dr) at the centre of gravity.
        """
        r, dt = self.radius, self.dt
        cos, sin = direction
        # domega = gain (T - r f_x'): eliminates the wheel spins.
        gain = dt / (self._spin_inertia - dt * wheels.slope)
        held = 1.0 / (1.0 + force.fx_sx * r * r * gain)
        push = r * gain * wheels.torque
        fx = held * (force.fx + force.fx_sx * push)
        fy = force.fy + force.fy_sx * (push - r * r * gain * fx)
        jxx, jxy = held * force.fx_sx, held * force.fx_sy
        jyx = held * force.fy_sx
        jyy = force.fy_sy - force.fy_sx * r * r * gain * jxy
        # Rows of A: patch velocity in wheel axes from (vx, vy, r) at the centre of gravity.
        arm_x, arm_y = self._arm_x, self.car.hub_y
        ax = (cos, sin, sin * arm_x - cos * arm_y)
        ay = (-sin, cos, cos * arm_x + sin * arm_y)
        matrix, right = [], []
        for row in range(3):
            along = ax[row] * jxx + ay[row] * jyx
            across = ax[row] * jxy + ay[row] * jyy
            matrix.append([(along * ax[c] + across * ay[c]).sum(0) for c in range(3)])
            right.append((ax[row] * fx + ay[row] * fy).sum(0))
        mass, inertia = self.values["mass"], self.values["yaw_inertia"]
        for row, m in enumerate((mass, mass, inertia)):
            matrix[row][row] = matrix[row][row] + m / dt
        yaw_rate = motion.yaw_rate
        right[0] += resistance + mass * yaw_rate * (motion.vy + self._cg_x * yaw_rate)
        right[1] -= mass * yaw_rate * motion.vx
        change = solve3(matrix, right)
        dx = ax[0] * change[0] + ax[1] * change[1] + ax[2] * change[2]
        dy = ay[0] * change[0] + ay[1] * change[1] + ay[2] * change[2]
        return fx - jxx * dx - jxy * dy, fy - jyx * dx - jyy * dy


def _per_wheel(values: Mapping[str, Array], name: str, axles) -> Array:
    return stacked([values[f"{name}_{axle}"] for axle in axles])
