"""Ordinary changes of the car and the constants that the equations use."""

from collections.abc import Mapping

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Array, Arrays, col, limit, per_car
from buggy_rl.proof.plants.rally.body import GRAVITY, wheel_places
from buggy_rl.proof.plants.rally.tyre import MEAN_RAMP

Changes = Mapping[str, Mapping[str, Array | float]]

# name -> argument -> (low, high) of the draw, numerically ordered. Sizes run from barely
# noticeable to severe in the direction away from NEUTRAL; SIGNED sizes may also be taken negative.
CHANGES: dict[str, dict[str, tuple[float, float]]] = {
    "grip_all": {"ratio": (0.45, 0.97)},
    "grip_balance": {"ratio": (0.65, 0.98)},
    "grip_patch": {"x": (-4.0, 4.0), "y": (-4.0, 4.0), "radius": (0.3, 1.5), "ratio": (0.25, 0.9)},
    "payload": {"mass": (0.05, 1.5), "x": (-0.12, 0.12), "y": (-0.06, 0.06), "z": (0.03, 0.15)},
    "rolling_resistance": {"coefficient": (0.003, 0.08)},
    "air_drag": {"area": (0.004, 0.15)},
    "wind": {"x": (0.5, 6.0), "y": (0.5, 6.0)},
    "slope": {"x": (0.003, 0.08), "y": (0.003, 0.08)},
    "drive_loss": {"ratio": (0.4, 0.97)},
    "throttle_dead_time": {"seconds": (0.005, 0.15)},
    "steering_dead_time": {"seconds": (0.005, 0.15)},
    "steering_gain": {"ratio": (0.6, 0.97)},
    "steering_offset": {"angle": (0.003, 0.08)},
    "steering_slack": {"angle": (0.005, 0.12)},
    "steering_rate": {"limit": (0.4, 2.5)},
    "dragging_wheel": {"torque": (0.002, 0.08)},
    "tyre_stiffness": {"ratio": (0.4, 0.95)},
    "suspension_stiffness": {"ratio": (0.4, 0.95)},
}
NEUTRAL: dict[str, dict[str, float]] = {
    "grip_all": {"ratio": 1.0},
    "grip_balance": {"ratio": 1.0},
    "grip_patch": {"x": 0.0, "y": 0.0, "radius": 1.0, "ratio": 1.0},
    "payload": {"mass": 0.0, "x": 0.0, "y": 0.0, "z": 0.06},
    "rolling_resistance": {"coefficient": 0.0},
    "air_drag": {"area": 0.0},
    "wind": {"x": 0.0, "y": 0.0},
    "slope": {"x": 0.0, "y": 0.0},
    "drive_loss": {"ratio": 1.0},
    "throttle_dead_time": {"seconds": 0.0},
    "steering_dead_time": {"seconds": 0.0},
    "steering_gain": {"ratio": 1.0},
    "steering_offset": {"angle": 0.0},
    "steering_slack": {"angle": 0.0},
    "steering_rate": {"limit": 1e6},
    "dragging_wheel": {"torque": 0.0},
    "tyre_stiffness": {"ratio": 1.0},
    "suspension_stiffness": {"ratio": 1.0},
}
SIGNED = {
    ("wind", "x"),
    ("wind", "y"),
    ("slope", "x"),
    ("slope", "y"),
    ("steering_offset", "angle"),
    ("dragging_wheel", "torque"),
}


def arguments(changes: Changes, cars: int) -> dict[str, Arrays]:
    """All change arguments as arrays [N], neutral where not given.

    grip_all ratio: all tyres. grip_balance ratio: front over rear grip. grip_patch: a round area
    of the floor (world x, y, radius, m) with grip times ratio. payload: mass, kg, at body place
    x, y from the empty centre of gravity and height z, m. rolling_resistance coefficient and
    air_drag area, m^2, are added. wind: world velocity, m/s. slope: rise per metre along world
    x, y. drive_loss ratio: motor torque. Dead times, s, and steering_offset, steering_slack
    angles, rad at the wheels, are added. steering_rate limit, rad/s. dragging_wheel torque, N m,
    on the left (+) or right (-) rear wheel. tyre_stiffness, suspension_stiffness ratios.

    Raises:
        ValueError: There is no such change or argument.
    """
    filled = {}
    for name, given in {**{name: {} for name in NEUTRAL}, **changes}.items():
        unknown = set(given) - set(NEUTRAL.get(name, {}))
        if name not in NEUTRAL or unknown:
            raise ValueError(f"unknown change or argument: {name} {sorted(unknown)}")
        filled[name] = {
            key: per_car(given.get(key, value), cars) for key, value in NEUTRAL[name].items()
        }
    return filled


def constants(parameters: Arrays, changes: Changes) -> Arrays:
    """Constants of the equations from drawn parameters and changes; SI units."""
    cars = len(parameters["mass"])
    p, c = parameters, arguments(changes, cars)
    k: Arrays = {name: np.array(value, dtype=float) for name, value in p.items()}
    _inertia(k, p, c)
    _suspension(k, c)
    _drive(k, p, c)
    _tyres(k, p, c)
    _steering(k, c)
    _surroundings(k, c)
    return k


def _inertia(k: Arrays, p: Arrays, c: dict[str, Arrays]) -> None:
    """Mass, centre of gravity, wheel places [N, 4] and inertias with the payload (Steiner)."""
    load, base = c["payload"], p["mass"]
    k["track"] = p["track_ratio"] * p["wheelbase"]
    k["mass"] = base + load["mass"]
    part = load["mass"] / k["mass"]
    shift_x, shift_y = part * load["x"], part * load["y"]
    bare_height = p["height_ratio"] * p["wheelbase"]
    k["height"] = bare_height + part * (load["z"] - bare_height)
    _places(k, p, shift_x, shift_y)
    # Two point masses about their common centre: reduced mass times distance squared.
    reduced = base * part
    rise = load["z"] - bare_height
    x, y, z = load["x"] * load["x"], load["y"] * load["y"], rise * rise
    for name, length, lever in (
        ("yaw", p["wheelbase"], x + y),
        ("roll", k["track"], y + z),
        ("pitch", p["wheelbase"], x + z),
    ):
        gyration = p[name + "_gyration"] * length
        k[name + "_inertia"] = base * gyration * gyration + reduced * lever


def _places(k: Arrays, p: Arrays, shift_x: Array, shift_y: Array) -> None:
    """Wheel places relative to the loaded centre of gravity, m [N, 4]."""
    front = (1.0 - p["front_share"]) * p["wheelbase"] - shift_x
    rear, half = front - p["wheelbase"], 0.5 * k["track"]
    k["wheel_x"] = np.stack([front, front, rear, rear], axis=1)
    k["wheel_y"] = np.stack([half - shift_y, -half - shift_y] * 2, axis=1)


def _suspension(k: Arrays, c: dict[str, Arrays]) -> None:
    """Static wheel loads, springs and dampers, [N, 4], sized for the empty car."""
    front = -k["wheel_x"][:, 2] / k["wheelbase"]
    left = -k["wheel_y"][:, 1] / k["track"]
    share = np.stack(
        [front * left, front * (1 - left), (1 - front) * left, (1 - front) * (1 - left)], axis=1
    )
    k["static_load"] = share * col(k["mass"] * GRAVITY)
    omega = 2.0 * np.pi * k["heave_frequency"]
    bare = k["mass"] - c["payload"]["mass"]
    spring = 0.25 * bare * omega * omega
    k["damper"] = col(0.5 * bare * omega * k["damping_ratio"]) * np.ones(4)
    k["spring"] = col(spring * c["suspension_stiffness"]["ratio"]) * np.ones(4)


def _drive(k: Arrays, p: Arrays, c: dict[str, Arrays]) -> None:
    """Gear, resistances, couplings and wheel inertia."""
    radius = p["radius"]
    k["wheel_inertia"] = 0.75 * p["wheel_mass"] * radius * radius
    no_load = p["volts"] / p["motor_constant"]
    # Friction takes about a tenth of the no-load speed.
    k["gear"] = no_load * radius / (1.1 * p["top_speed"])
    k["stall_torque"] = p["mass"] * p["stall_acceleration"] * radius / k["gear"]
    k["stall_current"] = k["stall_torque"] / p["motor_constant"]
    resistance = p["volts"] / k["stall_current"]
    k["battery_resistance"] = resistance * p["battery_part"]
    k["winding_resistance"] = resistance - k["battery_resistance"]
    k["rotor_friction"] = p["rotor_friction"] * k["stall_torque"]
    _shares(k, p)
    k["drive_ratio"] = c["drive_loss"]["ratio"]
    drag = c["dragging_wheel"]["torque"]
    zero = np.zeros_like(drag)
    k["wheel_drag"] = np.stack([zero, zero, np.maximum(drag, 0), np.maximum(-drag, 0)], axis=1)
    k["rolling"] = col(p["rolling"] + c["rolling_resistance"]["coefficient"])


def _shares(k: Arrays, p: Arrays) -> None:
    """Gear ratio to each wheel, shared by the differentials [N, 4], and their couplings."""
    front = 0.5 * p["four_wheel"] * p["front_drive"]
    k["gear_share"] = col(k["gear"]) * np.stack([front, front, 0.5 - front, 0.5 - front], axis=1)
    k["rear_coupling"] = p["coupling"]
    k["front_coupling"] = k["centre_coupling"] = p["coupling"] * p["four_wheel"]


def _tyres(k: Arrays, p: Arrays, c: dict[str, Arrays]) -> None:
    """Tyre constants shaped for the wheels [N, 4] and bristles [N, 4, 2, 1]."""
    balance, ratio = np.sqrt(c["grip_balance"]["ratio"]), c["grip_all"]["ratio"]
    front, rear = p["grip"] * ratio * balance, p["grip"] * p["rear_grip"] * ratio / balance
    k["grip"] = np.stack([front, front, rear, rear], axis=1)
    for name in ("slide_ratio", "stribeck_speed", "load_fall", "patch_length"):
        k[name] = col(p[name])
    soft = c["tyre_stiffness"]["ratio"] / (MEAN_RAMP * p["patch_length"])
    pair = np.stack([p["stiffness_x"] * soft, p["stiffness_y"] * soft], axis=1)
    k["bristle_stiffness"] = pair[:, None, :, None] * np.ones((4, 1, 1))
    # Damping of one free wheel turning on its bristles at a quarter of the weight.
    load = 0.25 * p["mass"] * GRAVITY
    seen = k["wheel_inertia"] / (p["radius"] * p["radius"])
    critical = 2.0 * np.sqrt(pair[:, 0] * load * seen) / load
    k["bristle_damping"] = col(p["bristle_damping_ratio"] * critical)


def _steering(k: Arrays, c: dict[str, Arrays]) -> None:
    """Command path and linkage."""
    k["throttle_dead_time"] = k["throttle_dead_time"] + c["throttle_dead_time"]["seconds"]
    k["steering_dead_time"] = k["steering_dead_time"] + c["steering_dead_time"]["seconds"]
    k["steer_gain"] = c["steering_gain"]["ratio"]
    k["steer_offset"] = c["steering_offset"]["angle"]
    k["slack"] = k["slack"] + c["steering_slack"]["angle"]
    k["servo_rate"] = np.minimum(k["servo_rate"], c["steering_rate"]["limit"])


def _surroundings(k: Arrays, c: dict[str, Arrays]) -> None:
    """Air, floor tilt and the floor patch."""
    k["drag_area"] = k["drag_area"] + c["air_drag"]["area"]
    k["wind_x"], k["wind_y"] = c["wind"]["x"], c["wind"]["y"]
    k["slope_x"], k["slope_y"] = c["slope"]["x"], c["slope"]["y"]
    for name, value in c["grip_patch"].items():
        k["patch_" + name] = col(value)
    k["has_patch"] = np.array(c["grip_patch"]["ratio"] != 1.0)


def floor_grip(k: Arrays, state: Arrays) -> Array:
    """Grip ratio of the floor under each wheel [N, 4]; the patch has a soft edge of 2 cm."""
    x, y = wheel_places(k, state)
    x, y = x - k["patch_x"], y - k["patch_y"]
    inside = limit((k["patch_radius"] - np.sqrt(x * x + y * y)) / 0.02 + 0.5, 0.0, 1.0)
    return 1.0 + (k["patch_ratio"] - 1.0) * inside
