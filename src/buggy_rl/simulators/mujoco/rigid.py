"""The car's equations of motion in closed form: what MuJoCo's step solves for it.

The tree is short: a chassis on a free joint and four wheels, each of which slides along the body's
z axis, is steered about it and spins about its axle. So the accelerations of slides and spins are
eliminated by hand, and six unknowns are left: the acceleration a of the body frame and the angular
one alpha, in body axes. Of each wheel, with r its hub, omega the chassis's turning, c what turning
and sliding add, and u its axle:

    a_w  = a + alpha x r + c + z s'',   c = omega x (omega x r) + 2 s' omega x z
    (m + A) s'' = F_z + m g_z - k (s - s_0) - d s' - m z . (a + alpha x r + c)
    (J + D) w'  = T + u . M - J u . alpha

with A and D the armatures, which weigh on their joint alone. Momentum and moment of momentum of the
whole car are the six equations. The inertia of a wheel is the same about its axle at every turn, so
that it is constant in body axes; its steering is held. The damper is implicit (A + h d for A), as
in MuJoCo's `implicitfast`, and the step is its semi-implicit Euler one.

Source: Featherstone 2008, Rigid Body Dynamics Algorithms, ch. 7; MuJoCo's documentation,
Computation.

Arrays are [n] over environments and [4, n] over wheels and environments, of NumPy or PyTorch.
Vectors are tuples of their three components in body axes.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from array_api_compat import array_namespace

from buggy_rl.core.vehicle import GRAVITY
from buggy_rl.simulators.mujoco.actuators import SHARES
from buggy_rl.simulators.mujoco.arrays import Array, column_like, solve3, stacked
from buggy_rl.simulators.mujoco.forces import AppliedForces
from buggy_rl.simulators.mujoco.weights import PITCH_SHARE, ROLL_SHARE, spring_reference

Vector = tuple[Array, Array, Array]


class RigidState(NamedTuple):
    """State of the car that MuJoCo's qpos and qvel hold, without the turns of the wheels."""

    place: Vector
    """[n] of the body frame [m]."""
    turn: tuple[Array, Array, Array, Array]
    """[n] quaternion from body to world axes, w first."""
    slide: Array
    """[4, n] [m]"""
    velocity: Vector
    """[n] of the body frame in the world [m/s]."""
    omega: Vector
    """[n] turning of the chassis in body axes [rad/s]."""
    slide_speed: Array
    """[4, n] [m/s]"""
    spin: Array
    """[4, n] of the wheels about their axles [rad/s]."""


class RigidCar:
    """Masses and struts of n cars.

    Args:
        car: Compiled model, or what has its places, weights and timestep.
        values: Parameter name -> [1] or [n].
    """

    def __init__(self, car: Any, values: Mapping[str, Array]) -> None:
        lengths, weights = car.dimensions, car.weights
        self.hub = (car.hub_x, car.hub_y, lengths.wheel_radius - lengths.cg_height)
        self.radius, self.h, self.weights = lengths.wheel_radius, car.timestep, weights
        self.slide_reference = spring_reference(weights, lengths.wheelbase, values)
        driven = [weights.driveline_inertia if share else 0.0 for share in SHARES[car.drive]]
        self.spin_inertia = weights.spin_inertia + column_like(driven, values["mass"])
        self.mass = values["mass"] - 4 * weights.wheel_mass
        self.centre, self.inertia = self._chassis(lengths, values)

    def _chassis(
        self, lengths: Any, values: Mapping[str, Array]
    ) -> tuple[tuple[Array, Array], Vector]:
        """Centre of gravity (x, z) of the chassis [n] in the body frame, and its inertias [n].

        As `weights.chassis_inertia`.
        """
        wheel, (x, y, z) = self.weights, self.hub
        mass = values["mass"]
        cg_x = lengths.cg_to_front_axle - lengths.sensor_to_cg - values["cg_to_front_axle"]
        centre = (mass * cg_x - wheel.wheel_mass * x.sum(0)) / self.mass
        arms = ((x - cg_x) ** 2 + y**2).sum(0)
        wheels = 4 * wheel.tilt_inertia + wheel.wheel_mass * arms
        yaw = values["yaw_inertia"] - wheels - self.mass * (centre - cg_x) ** 2
        below = -4 * wheel.wheel_mass * z / self.mass
        return (centre, below), (ROLL_SHARE * yaw, PITCH_SHARE * yaw, yaw)

    def step(self, state: RigidState, forces: AppliedForces, steering_angle: Array) -> RigidState:
        """State a timestep later.

        Args:
            state: At its start.
            forces: During it.
            steering_angle: [n] of the front wheels [rad].
        """
        weights, h = self.weights, self.h
        m, tilt, spin_inertia = weights.wheel_mass, weights.tilt_inertia, weights.spin_inertia
        xp = array_namespace(state.spin)
        rotation = _rotation(state.turn)
        omega = state.omega
        gravity: Any = tuple(-GRAVITY * rotation[2][i] for i in range(3))
        hub = (self.hub[0], self.hub[1], self.hub[2] + state.slide)
        pull = _turned_back(rotation, (forces.along_x, forces.along_y, forces.push))
        # F = (x, y, N) at the patch, a radius below the hub: M = (0, 0, -r) x F in world axes.
        moment = (self.radius * forces.along_y, -self.radius * forces.along_x)
        moment = _turned_back(rotation, (*moment, xp.zeros_like(moment[0])))
        sin, cos = xp.sin(steering_angle), xp.cos(steering_angle)
        none, one = xp.zeros_like(sin), xp.ones_like(sin)
        axle_x = xp.stack([-sin, -sin, none, none])  # u = (-sin, cos, 0)
        axle_y = xp.stack([cos, cos, one, one])

        # The slides: s'' = free - kept (a + alpha x r + c)_z
        along = m + weights.strut_armature + h * weights.spring_damping
        strut = weights.spring_rate * (state.slide - self.slide_reference)
        strut = strut + weights.spring_damping * state.slide_speed
        free, kept = (pull[2] + m * gravity[2] - strut) / along, m / along
        turning = _cross(omega, _cross(omega, hub))
        coriolis = (
            turning[0] + 2 * state.slide_speed * omega[1],
            turning[1] - 2 * state.slide_speed * omega[0],
            turning[2],
        )
        upright = m * (1 - kept)  # mass of a wheel along the struts, as the chassis feels it
        # The spins: w' = (driving - J u . alpha) / (J + D)
        driving = forces.torque + axle_x * moment[0] + axle_y * moment[1]
        rolling = axle_x * omega[0] + axle_y * omega[1]
        flat = (spin_inertia - tilt) * rolling + spin_inertia * state.spin
        gyro = _cross(
            omega,
            (tilt * omega[0] + flat * axle_x, tilt * omega[1] + flat * axle_y, tilt * omega[2]),
        )
        react = spin_inertia * driving / self.spin_inertia

        # Right sides of the six equations
        each = (
            pull[0] + m * (gravity[0] - coriolis[0]),
            pull[1] + m * (gravity[1] - coriolis[1]),
            pull[2] + m * (gravity[2] - free) - upright * coriolis[2],
        )
        about = _cross(hub, each)
        mass, inertia = self.mass, self.inertia
        centre: Any = (self.centre[0], xp.zeros_like(self.centre[0]), self.centre[1])
        resistance = (*forces.resistance, xp.zeros_like(forces.resistance[0]))
        drag, swing = _turned_back(rotation, resistance), _cross(omega, _cross(omega, centre))
        own: Any = tuple(drag[i] + mass * (gravity[i] - swing[i]) for i in range(3))
        own_about = _cross(centre, own)
        own_gyro = _cross(omega, tuple(inertia[i] * omega[i] for i in range(3)))
        linear = [each[i].sum(0) + own[i] for i in range(3)]
        turned = (
            about[0] + moment[0] - react * axle_x - gyro[0],
            about[1] + moment[1] - react * axle_y - gyro[1],
            about[2] + moment[2] - gyro[2],
        )
        angular = [turned[i].sum(0) + own_about[i] - own_gyro[i] for i in range(3)]

        # Left sides: diagonal in a, `beside` between a and alpha, `about_all` in alpha
        x, y, z = hub
        shape = xp.zeros_like(z)
        heavy = (mass + 4 * m, mass + 4 * m, mass + 4 * upright)

        def over(wheels: Any) -> Any:
            return (wheels + shape).sum(0)

        ahead, aside, above = (over(m * part) for part in hub)
        share = upright / m
        beside = (
            (0.0, above + mass * centre[2], -aside),
            (-above - mass * centre[2], 0.0, ahead + mass * centre[0]),
            (share * aside, -share * ahead - mass * centre[0], 0.0),
        )
        lost = spin_inertia - tilt - spin_inertia**2 / self.spin_inertia
        own_square = tuple(mass * part**2 for part in centre)
        xx = over(m * z * z + upright * y * y + tilt + lost * axle_x**2) + own_square[2]
        yy = over(m * z * z + upright * x * x + tilt + lost * axle_y**2)
        yy = yy + own_square[0] + own_square[2]
        zz = over(m * (x * x + y * y) + tilt) + own_square[0]
        xy = over(lost * axle_x * axle_y - upright * x * y)
        xz = over(-m * x * z) - mass * centre[0] * centre[2]
        yz = over(-m * y * z)
        about_all = [
            [xx + inertia[0], xy, xz],
            [xy, yy + inertia[1], yz],
            [xz, yz, zz + inertia[2]],
        ]
        matrix = [
            [
                about_all[i][j] - sum(beside[k][i] * beside[k][j] / heavy[k] for k in range(3))
                for j in range(3)
            ]
            for i in range(3)
        ]
        right = [
            angular[i] - sum(beside[k][i] * linear[k] / heavy[k] for k in range(3))
            for i in range(3)
        ]
        alpha = solve3(matrix, right)
        a = [
            (linear[k] - sum(beside[k][i] * alpha[i] for i in range(3))) / heavy[k]
            for k in range(3)
        ]

        raised = a[2] + alpha[0] * y - alpha[1] * x + coriolis[2]
        slide_speed = state.slide_speed + h * (free - kept * raised)
        turned_axle = axle_x * alpha[0] + axle_y * alpha[1]
        spin = state.spin + h * (driving - spin_inertia * turned_axle) / self.spin_inertia
        velocity: Any = tuple(
            state.velocity[i] + h * sum(rotation[i][k] * a[k] for k in range(3)) for i in range(3)
        )
        omega: Any = tuple(omega[i] + h * alpha[i] for i in range(3))
        return RigidState(
            place=tuple(state.place[i] + h * velocity[i] for i in range(3)),  # type: ignore[arg-type]
            turn=_turned_on(state.turn, omega, h),
            slide=state.slide + h * slide_speed,
            velocity=velocity,
            omega=omega,
            slide_speed=slide_speed,
            spin=spin,
        )


def _cross(a: Any, b: Any) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def _rotation(turn: Sequence[Array]) -> tuple[Vector, Vector, Vector]:
    """Rows of the matrix from body to world axes."""
    w, x, y, z = turn
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _turned_back(rotation: Sequence[Vector], v: Sequence[Array]) -> Vector:
    """A vector of the world in body axes."""
    x, y, z = (
        rotation[0][i] * v[0] + rotation[1][i] * v[1] + rotation[2][i] * v[2] for i in range(3)
    )
    return x, y, z


def _turned_on(turn: Sequence[Array], omega: Vector, h: Any) -> tuple[Array, Array, Array, Array]:
    """The quaternion after h seconds of turning at `omega` in body axes, of length 1."""
    w, x, y, z = turn
    xp = array_namespace(w)
    # cos(e) and sin(e) / |omega| of half the angle e by their series: e^2 is below 0.01 at 80 rad/s
    square = (omega[0] ** 2 + omega[1] ** 2 + omega[2] ** 2) * (0.25 * h * h)
    c = 1 - square / 2 * (1 - square / 12 * (1 - square / 30))
    s = 0.5 * h * (1 - square / 6 * (1 - square / 20 * (1 - square / 42)))
    p, q, r = (s * part for part in omega)
    after = (
        w * c - x * p - y * q - z * r,
        w * p + x * c + y * r - z * q,
        w * q - x * r + y * c + z * p,
        w * r + x * q - y * p + z * c,
    )
    scale = 1 / xp.sqrt(sum(part * part for part in after))
    w, x, y, z = (part * scale for part in after)
    return w, x, y, z


def read_state(car: Any, qpos: Array, qvel: Array) -> RigidState:
    """The state that MuJoCo's coordinates [n, nq] and speeds [n, nv] are."""
    px, py, pz = qpos[:, :3].T
    w, x, y, z = qpos[:, 3:7].T
    vx, vy, vz = qvel[:, :3].T
    p, q, r = qvel[:, 3:6].T
    return RigidState(
        (px, py, pz),
        (w, x, y, z),
        qpos[:, car.slide + 1].T,
        (vx, vy, vz),
        (p, q, r),
        qvel[:, car.slide].T,
        qvel[:, car.spin].T,
    )


def written_state(car: Any, state: RigidState, steering_angle: Array) -> tuple[Array, Array]:
    """MuJoCo's coordinates [n, nq] and speeds [n, nv].

    The wheels' turns are 0: they have no bearing on anything.
    """
    zero = 0.0 * steering_angle
    qpos, qvel = [zero] * (7 + 10), [zero] * (6 + 10)
    qpos[:7], qvel[:6] = [*state.place, *state.turn], [*state.velocity, *state.omega]
    for wheel in range(4):
        slide, spin = int(car.slide[wheel]), int(car.spin[wheel])
        qpos[slide + 1], qvel[slide] = state.slide[wheel], state.slide_speed[wheel]
        qvel[spin] = state.spin[wheel]
    for steer in car.steer:
        qpos[int(steer) + 1] = steering_angle
    return stacked(qpos, axis=-1), stacked(qvel, axis=-1)
