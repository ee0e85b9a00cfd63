"""Changes of the rally car as effects of the textbook, by name, sign, unit and meaning.

| effect | change | conversion |
|---|---|---|
| `tire_grip`, `grip_balance`, `grip_patch` | `grip_all`, `grip_balance`, `grip_patch` | none |
| `cornering_stiffness` | `tyre_stiffness` | none; slip stiffness along the wheel changes too |
| `payload` | `payload` | (mass_ratio - 1) m, above the centre of gravity, at 0.06 m |
| `rolling_resistance` | `rolling_resistance` | coefficient = deceleration m' / (m g) |
| `aerodynamic_drag` | `air_drag` | area = 2 coefficient m' / density; twice from the side |
| `wind` | `wind` | m' force = density area speed^2 (1/2 + 1) / 2, mean of front and side |
| `floor_slope` | `slope` | rise of a floor on which the free car accelerates by that much |
| both dead times | both dead times | none |
| `steering_gain` | `steering_gain` | none |
| `steering_offset`, `steering_backlash`, `steering_rate_limit` | offset, slack, rate | times lock |

m is the car's mass with its load, m' that with what turning wheels and rotor add: drags, wind and
slope are accelerations of the free car on its wheels. The rest have no effect of the textbook:

- `drive_loss` scales the motor's torque. The textbook's gain scales the duty cycle, and with it the
  speed that is reached; that both are one holds for some simulators only.
- `dragging_wheel` brakes one wheel by a torque. The textbook's bent axle is a moment with a tenth
  of that drag.
- `suspension_stiffness`: no effect has a suspension.
"""

import numpy as np

from buggy_rl.proof.plants.faults import PlantFaults
from buggy_rl.proof.plants.rally.arrays import Array, Arrays
from buggy_rl.proof.plants.rally.body import AIR_DENSITY, GRAVITY
from buggy_rl.proof.plants.rally.changes import NEUTRAL

EFFECTS = frozenset(
    (
        "tire_grip", "grip_balance", "grip_patch", "cornering_stiffness", "payload",
        "rolling_resistance", "aerodynamic_drag", "wind", "floor_slope", "throttle_dead_time",
        "steering_dead_time", "steering_gain", "steering_offset", "steering_backlash",
        "steering_rate_limit",
    )
)  # fmt: skip
"""Effects of the textbook that the rally car can have."""
FRONT_AND_SIDE = 1.5  # [-] drag of an air stream, mean of front and side over that of the front


def changes_of(faults: PlantFaults, k: Arrays) -> dict[str, dict[str, Array]]:
    """The changes of rally cars, arguments [N], that are given faults.

    Args:
        faults: By their textbook names.
        k: Constants of the unchanged cars.
    """
    mass = k["mass"] * faults["payload.mass_ratio"]
    moved = mass + turning_mass(k)
    area = 2.0 * faults["aerodynamic_drag.coefficient"] * moved / AIR_DENSITY
    weight = mass * GRAVITY
    found = {
        "grip_all": {"ratio": faults["tire_grip.grip"]},
        "grip_balance": {"ratio": faults["grip_balance.front_to_rear"]},
        "grip_patch": {n: faults[f"grip_patch.{n}"] for n in ("x", "y", "radius")}
        | {"ratio": faults["grip_patch.grip"]},
        "tyre_stiffness": {"ratio": faults["cornering_stiffness.ratio"]},
        "payload": {**NEUTRAL["payload"], "mass": mass - k["mass"]},
        "rolling_resistance": {
            "coefficient": faults["rolling_resistance.deceleration"] * moved / weight
        },
        "air_drag": {"area": area},
        "wind": _wind(faults, moved, k["drag_area"] + area),
        "slope": _slope(faults, moved / weight),
        **_steering(faults, k["lock"]),
    }
    cars = len(mass)
    return {
        change: {name: np.broadcast_to(value, (cars,)) for name, value in arguments.items()}
        for change, arguments in found.items()
    }


def turning_mass(k: Arrays) -> Array:
    """What four wheels and the rotor add to the mass of a rolling car, kg [N]."""
    rotor = k["rotor_inertia"] * k["gear"] * k["gear"]
    return (4.0 * k["wheel_inertia"] + rotor) / (k["radius"] * k["radius"])


def _wind(faults: PlantFaults, moved: Array, area: Array) -> dict[str, Array]:
    """World velocity of an air stream that pushes a standing car by the stated force."""
    x, y = faults["wind.force_x"], faults["wind.force_y"]
    size = float(np.hypot(x, y))
    drag = 0.5 * AIR_DENSITY * area * FRONT_AND_SIDE  # [kg/m]
    speed = np.sqrt(moved * size / drag) / (size or 1.0)
    return {"x": speed * x, "y": speed * y}


def _slope(faults: PlantFaults, per_acceleration: Array) -> dict[str, Array]:
    """Rise over run: a = -g rise / sqrt(1 + rise^2), of a car on turning wheels."""
    x, y = (faults[f"floor_slope.along_{axis}"] * per_acceleration for axis in "xy")
    steep = np.sqrt(1.0 - x * x - y * y)
    return {"x": -x / steep, "y": -y / steep}


def _steering(faults: PlantFaults, lock: Array) -> dict[str, dict[str, Array | float]]:
    """Dead times, and changes of the linkage in rad at the wheels."""
    return {
        "throttle_dead_time": {"seconds": faults["throttle_dead_time.dead_time"]},
        "steering_dead_time": {"seconds": faults["steering_dead_time.dead_time"]},
        "steering_gain": {"ratio": faults["steering_gain.gain"]},
        "steering_offset": {"angle": faults["steering_offset.offset"] * lock},
        "steering_slack": {"angle": faults["steering_backlash.width"] * lock},
        "steering_rate": {"limit": faults["steering_rate_limit.rate"] * lock},
    }
