"""Body motion: plane motion, heave, roll and pitch on spring-damper corners, and wheel loads.

Axes after ISO 8855: x forward, y left, z up; roll positive with the left side up, pitch positive
with the nose down. The roll and pitch axes lie on the floor, so tyre forces act at the distance
of the centre-of-gravity height below the centre of gravity (Rajamani, Vehicle Dynamics and
Control, chapter on roll dynamics and rollover; Milliken, Race Car Vehicle Dynamics, chapter on
wheel loads). Unsprung masses are lumped into the body; angles are small.
"""

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Array, Arrays, col, limit, sum4, to_body, to_world

GRAVITY = 9.81
AIR_DENSITY = 1.2


def contact_velocity(k: Arrays, state: Arrays, angle: Array) -> tuple[Array, Array]:
    """Velocity of the wheel contact points over the floor in the wheel frames, m/s, [N, 4].

    Rigid-body kinematics with the lever of roll and pitch rates; angle [N, 4] wheel steer, rad.
    """
    height = k["height"]
    x = col(state["vx"] - height * state["pitch_rate"]) - col(state["yaw_rate"]) * k["wheel_y"]
    y = col(state["vy"] + height * state["roll_rate"]) + col(state["yaw_rate"]) * k["wheel_x"]
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * x + sine * y, cosine * y - sine * x


def compression(k: Arrays, state: Arrays) -> Array:
    """Suspension compression of each corner beyond its static one, m [N, 4], flat floor."""
    return (
        col(state["pitch"]) * k["wheel_x"] - col(state["roll"]) * k["wheel_y"] - col(state["heave"])
    )


def wheel_loads(k: Arrays, state: Arrays, inputs: Arrays) -> Array:
    """Vertical load of each wheel, N [N, 4], never negative (a wheel may lift).

    Static load plus spring and damper force of the corner; inputs["road"] is the floor height
    below each wheel, m, and inputs["road_rate"] its rate, m/s.
    """
    travel = compression(k, state) + inputs["road"]
    rate = (
        col(state["pitch_rate"]) * k["wheel_x"]
        - col(state["roll_rate"]) * k["wheel_y"]
        - col(state["heave_rate"])
        + inputs["road_rate"]
    )
    return np.maximum(k["static_load"] + k["spring"] * travel + k["damper"] * rate, 0.0)


def wheel_places(k: Arrays, state: Arrays) -> tuple[Array, Array]:
    """World position of the wheel contact points, m, [N, 4] each."""
    x, y = to_world(state["yaw"], k["wheel_x"], k["wheel_y"])
    return col(state["x"]) + x, col(state["y"]) + y


def air_force(k: Arrays, state: Arrays) -> tuple[Array, Array]:
    """Aerodynamic drag in the body frame, N [N], quadratic in the speed relative to the air.

    Rajamani, chapter on longitudinal dynamics: half density times drag area times speed squared.
    """
    wind_x, wind_y = to_body(state["yaw"], k["wind_x"], k["wind_y"])
    x, y = state["vx"] - wind_x, state["vy"] - wind_y
    scale = -0.5 * AIR_DENSITY * k["drag_area"] * np.sqrt(x * x + y * y)
    # Seen from the side a car shows about twice its frontal area.
    return scale * x, 2.0 * scale * y


def slope_force(k: Arrays, state: Arrays) -> tuple[Array, Array]:
    """Weight component along a tilted floor in the body frame, N [N]."""
    steep = np.sqrt(1.0 + k["slope_x"] * k["slope_x"] + k["slope_y"] * k["slope_y"])
    weight = -k["mass"] * GRAVITY / steep
    return to_body(state["yaw"], weight * k["slope_x"], weight * k["slope_y"])


def total_force(
    k: Arrays,
    state: Arrays,
    inputs: Arrays,
    tyre: tuple[Array, Array, Array],
    angle: Array,
    load: Array,
) -> tuple[Array, Array, Array, Array, Array]:
    """Sum of forces on the car: (F_x, F_y, M_z, tyre F_x, tyre F_y), body frame, [N] each.

    tyre = (F_x, F_y, M_z) in the wheel frames [N, 4]. A local floor grade tilts the wheel load.
    """
    cosine, sine = np.cos(angle), np.sin(angle)
    x = cosine * tyre[0] - sine * tyre[1] - load * inputs["grade_x"]
    y = sine * tyre[0] + cosine * tyre[1] - load * inputs["grade_y"]
    moment = sum4(k["wheel_x"] * y - k["wheel_y"] * x + tyre[2]) + inputs["moment"]
    air, slope = air_force(k, state), slope_force(k, state)
    tyre_x, tyre_y = sum4(x), sum4(y)
    force_x = tyre_x + air[0] + slope[0] + inputs["force_x"]
    return force_x, tyre_y + air[1] + slope[1] + inputs["force_y"], moment, tyre_x, tyre_y


def move_plane(k: Arrays, state: Arrays, force: tuple[Array, Array, Array], dt: float) -> None:
    """Newton-Euler step in the plane (Rajamani, chapter on lateral dynamics); writes the state.

    The turning of the body frame is a rotation that keeps the speed exactly (Cayley form), so the
    centripetal terms can neither add nor remove energy.
    """
    rate = state["yaw_rate"] + dt * force[2] / k["yaw_inertia"]
    x = state["vx"] + dt * force[0] / k["mass"]
    y = state["vy"] + dt * force[1] / k["mass"]
    half = 0.5 * dt * rate
    cosine, sine = (1.0 - half * half) / (1.0 + half * half), 2.0 * half / (1.0 + half * half)
    mid_x, mid_y = to_world(state["yaw"], x, y)
    state["x"], state["y"] = state["x"] + dt * mid_x, state["y"] + dt * mid_y
    state["yaw"] = state["yaw"] + dt * rate
    state["vx"], state["vy"] = cosine * x + sine * y, cosine * y - sine * x
    state["yaw_rate"] = rate


def move_attitude(
    k: Arrays, state: Arrays, inputs: Arrays, load: Array, tyre: tuple[Array, Array], dt: float
) -> None:
    """Heave, roll and pitch step (semi-implicit Euler); tyre = (F_x, F_y) sums, [N]; writes.

    Moments about the centre of gravity: wheel loads at their places, tyre forces at the floor,
    and the tipping moment of the weight (Rajamani, chapter on roll dynamics).
    """
    tip = k["mass"] * GRAVITY * k["height"]
    lift = sum4(load) - k["mass"] * GRAVITY + inputs["lift"]
    roll = sum4(load * k["wheel_y"]) + k["height"] * tyre[1] + tip * state["roll"]
    pitch = -sum4(load * k["wheel_x"]) - k["height"] * tyre[0] + tip * state["pitch"]
    accelerations = {
        "heave": lift / k["mass"],
        "roll": (roll + inputs["roll_moment"]) / k["roll_inertia"],
        "pitch": (pitch + inputs["pitch_moment"]) / k["pitch_inertia"],
    }
    for name, value in accelerations.items():
        state[name + "_rate"] = state[name + "_rate"] + dt * value
        # The bump stops end the travel; the bound only matters if a car is thrown about.
        state[name] = limit(state[name] + dt * state[name + "_rate"], -0.35, 0.35)


def body_energy(k: Arrays, state: Arrays) -> Array:
    """Kinetic energy of the body and elastic energy of the suspension, J [N]."""
    speed = state["vx"] * state["vx"] + state["vy"] * state["vy"]
    energy = k["mass"] * (speed + state["heave_rate"] * state["heave_rate"])
    for name, rate in (("yaw", "yaw_rate"), ("roll", "roll_rate"), ("pitch", "pitch_rate")):
        energy = energy + k[name + "_inertia"] * state[rate] * state[rate]
    travel = compression(k, state)
    tip = k["mass"] * GRAVITY * k["height"]
    tilt = state["roll"] * state["roll"] + state["pitch"] * state["pitch"]
    return 0.5 * (energy + sum4(k["spring"] * travel * travel) - tip * tilt)
