"""Motor, battery, gear, differential, slipper clutch and wheel spin.

Sources: the direct-current motor equations with back-EMF (Rajamani, chapter on electric and
hybrid vehicles; any text on electric drives), battery as open-circuit voltage with internal
resistance, viscous limited-slip differential (Milliken, chapter on the drivetrain).
"""

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Array, Arrays, col, limit, sum4

# Speed over which dry friction torques reach their full value, rad/s: a smooth sign function.
WHEEL_STICK = 1.0
ROTOR_STICK = 10.0


def motor_current(k: Arrays, state: Arrays) -> Array:
    """Motor current, A [N]: chopped battery voltage less back-EMF over all resistances.

    The battery current is the duty times the motor current, so the internal resistance appears
    with the duty squared. The controller never brakes: the current is not below zero.
    """
    duty = state["duty"]
    # The open-circuit voltage falls slowly with the charge taken (in ampere hours).
    volts = k["volts"] * (1.0 - 0.08 * state["charge"] / k["capacity"])
    drive = duty * volts - k["motor_constant"] * state["rotor"]
    resistance = k["winding_resistance"] + duty * duty * k["battery_resistance"]
    return np.maximum(drive / resistance, 0.0)


def rotor_torque(k: Arrays, state: Arrays, current: Array, inputs: Arrays) -> Array:
    """Net torque on the rotor before the gear, N m [N]: electric less friction and grease drag."""
    sign = limit(state["rotor"] / ROTOR_STICK, -1.0, 1.0)
    electric = k["motor_constant"] * current * k["drive_ratio"] * inputs["drive"]
    return electric - sign * (k["rotor_friction"] + inputs["rotor_drag"])


def wheel_torque(k: Arrays, state: Arrays, inputs: Arrays, force_x: Array, load: Array) -> Array:
    """Torque on each wheel from floor, rolling resistance and drags, N m [N, 4], without drive.

    Rolling resistance moment proportional to the load (Pacejka, chapter on tyre fundamentals).
    """
    sign = limit(state["wheel"] / WHEEL_STICK, -1.0, 1.0)
    resist = k["rolling"] * load * col(k["radius"]) + k["wheel_drag"] + inputs["resist"]
    return inputs["wheel_torque"] - col(k["radius"]) * force_x - sign * resist


def differential_torque(k: Arrays, wheel: Array) -> Array:
    """Torque of the viscous differentials on each wheel, N m [N, 4], without drive torque.

    Each driven axle couples left and right; a four-wheel-driven car also couples the axles.
    """
    front = k["front_coupling"] * (wheel[:, 0] - wheel[:, 1])
    rear = k["rear_coupling"] * (wheel[:, 2] - wheel[:, 3])
    centre = (
        k["centre_coupling"] * 0.25 * ((wheel[:, 0] + wheel[:, 1]) - (wheel[:, 2] + wheel[:, 3]))
    )
    torque = np.empty_like(wheel)
    torque[:, 0], torque[:, 1] = -front - centre, front - centre
    torque[:, 2], torque[:, 3] = -rear + centre, rear + centre
    return torque


def shaft_torque(k: Arrays, free: Array, rotor: Array) -> Array:
    """Torque in the shaft behind the rotor that keeps rotor and wheels geared together, N m [N].

    The rotor turns with the gear ratio times the mean of the driven wheels (open differentials),
    so the constraint force follows from Newton-Euler for rotor and wheels (free: torques on the
    wheels [N, 4]; rotor: torque on the rotor [N]).
    """
    share = k["gear_share"]
    wheels = sum4(share * free) / k["wheel_inertia"]
    inverse = 1.0 / k["rotor_inertia"] + sum4(share * share) / k["wheel_inertia"]
    return (rotor / k["rotor_inertia"] - wheels) / inverse


def turn_wheels(
    k: Arrays, state: Arrays, inputs: Arrays, free: Array, rotor: Array, dt: float
) -> Array:
    """Step wheel and rotor speeds; returns the slip speed of the clutch, rad/s [N]; writes.

    The clutch sticks below its limit torque (inputs["clutch"], infinite in the standard car);
    once it slips it carries three quarters of it until both sides have the same speed.
    """
    geared = sum4(k["gear_share"] * state["wheel"])
    slip = state["rotor"] - geared
    stuck = shaft_torque(k, free, rotor)
    slipping = (np.abs(stuck) > inputs["clutch"]) | (np.abs(slip) > 1e-6 + np.abs(geared) * 1e-9)
    sliding = 0.75 * inputs["clutch"] * np.where(slip + 1e-12 * stuck > 0.0, 1.0, -1.0)
    torque = np.where(slipping, np.where(slipping, sliding, 0.0), stuck)
    wheel = state["wheel"] + dt * (free + k["gear_share"] * col(torque)) / col(k["wheel_inertia"])
    own = state["rotor"] + dt * (rotor - torque) / k["rotor_inertia"]
    geared = sum4(k["gear_share"] * wheel)
    # The clutch sticks again when the slip would change its sign within this step.
    sticks = ~slipping | ((own - geared) * slip < 0.0)
    state["wheel"], state["rotor"] = wheel, np.where(sticks, geared, own)
    return state["rotor"] - geared


def step_drivetrain(
    k: Arrays,
    state: Arrays,
    inputs: Arrays,
    throttle: Array,
    force_x: Array,
    load: Array,
    dt: float,
) -> None:
    """One step of duty, current, battery charge, rotor and wheels; writes the state.

    throttle [N] in [-1, 1]; -1 is no drive. The controller ramps the duty with a short lag.
    """
    target = 0.5 * (limit(throttle, -1.0, 1.0) + 1.0)
    state["duty"] = state["duty"] + (target - state["duty"]) * (dt / (dt + k["esc_lag"]))
    current = motor_current(k, state)
    rotor = rotor_torque(k, state, current, inputs)
    free = wheel_torque(k, state, inputs, force_x, load) + differential_torque(k, state["wheel"])
    state["clutch_slip"] = turn_wheels(k, state, inputs, free, rotor, dt)
    state["charge"] = state["charge"] + current * state["duty"] * (dt / 3600.0)
    state["current"] = current


def spin_energy(k: Arrays, state: Arrays) -> Array:
    """Kinetic energy of rotor and wheels about their axles, J [N]."""
    wheels = sum4(state["wheel"] * state["wheel"]) * k["wheel_inertia"]
    return 0.5 * (wheels + k["rotor_inertia"] * state["rotor"] * state["rotor"])
