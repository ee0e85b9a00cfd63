"""The rally car's parameters as a plant declares them, and one car's numbers from a seed."""

import numpy as np

from buggy_rl.core.parameters import Parameter
from buggy_rl.proof.plants.rally.arrays import Arrays
from buggy_rl.proof.plants.rally.parameters import RANGES, draw_parameters

PLACES = 8  # numbers that place the unknown effects, "hidden" in the author's draw
ABOUT: dict[str, tuple[str, str]] = {  # parameter -> unit and meaning
    "wheelbase": ("m", "Front to rear axle."),
    "front_share": ("-", "Share of the weight on the front axle."),
    "track_ratio": ("-", "Track over wheelbase."),
    "height_ratio": ("-", "Height of the centre of gravity over wheelbase."),
    "yaw_gyration": ("-", "Radius of gyration about z over wheelbase."),
    "roll_gyration": ("-", "Radius of gyration about x over track."),
    "pitch_gyration": ("-", "Radius of gyration about y over wheelbase."),
    "radius": ("m", "Of a wheel."),
    "wheel_mass": ("kg", "Of one wheel."),
    "heave_frequency": ("Hz", "Of the body on its springs."),
    "damping_ratio": ("-", "Of the dampers, over critical."),
    "grip": ("-", "Friction of the front tyres."),
    "rear_grip": ("-", "Friction of the rear tyres over that."),
    "slide_ratio": ("-", "Sliding over static friction."),
    "stribeck_speed": ("m/s", "Over which friction falls to that of sliding."),
    "load_fall": ("-", "Loss of friction when the load doubles."),
    "patch_length": ("m", "Of a tyre's contact."),
    "stiffness_x": ("-", "Longitudinal force over load and slip."),
    "stiffness_y": ("1/rad", "Lateral force over load and slip angle."),
    "bristle_damping_ratio": ("-", "Of a standing wheel, over critical."),
    "coupling": ("N m s", "Of the viscous differentials."),
    "top_speed": ("m/s", "Level, at full drive."),
    "volts": ("V", "Of the charged battery."),
    "motor_constant": ("V s", "Back-EMF over rotor speed."),
    "stall_acceleration": ("m/s^2", "Full drive at standstill."),
    "battery_part": ("-", "Share of the resistance in battery and leads."),
    "rotor_inertia": ("kg m^2", "Of the motor."),
    "rotor_friction": ("-", "Dry torque over the stall torque."),
    "capacity": ("A h", "Of the battery."),
    "esc_lag": ("s", "Time constant of the speed controller."),
    "throttle_dead_time": ("s", "Of radio and speed controller."),
    "steering_dead_time": ("s", "Of radio and servo."),
    "lock": ("rad", "Road-wheel angle at full command."),
    "servo_lag": ("s", "Time constant of the servo."),
    "servo_rate": ("rad/s", "Fastest servo, at the wheels."),
    "slack": ("rad", "Play between servo and rack."),
    "ackermann": ("-", "Share of Ackermann's difference of angles."),
    "rolling": ("-", "Rolling resistance over load."),
    "drag_area": ("m^2", "Drag coefficient times frontal area."),
}


def _parameters() -> tuple[Parameter, ...]:
    ranged = [
        Parameter(name, 0.5 * (low + high), low, high, *ABOUT[name])
        for name, (low, high) in RANGES.items()
    ]
    places = [
        Parameter(f"hidden_{n}", 0.5, 0.0, 1.0, "-", "Places unknown effects.")
        for n in range(PLACES)
    ]
    return (
        Parameter("mass", 2.5, 1.5, 4.0, "kg", "Whole car."),
        Parameter("four_wheel", 0.0, 0.0, 1.0, "-", "1 where both axles are driven, 0 the rear."),
        Parameter("front_drive", 0.425, 0.35, 0.5, "-", "Share of the torque in front, of four."),
        *ranged,
        *places,
    )


PARAMETERS = _parameters()
"""The middle of the author's ranges: a car with rear-wheel drive."""


def drawn_parameters(seed: int) -> dict[str, float]:
    """Numbers of one car, by the author's own draw."""
    drawn = draw_parameters(np.random.default_rng(seed), 1)
    places = drawn.pop("hidden")[0]
    found = {name: float(value[0]) for name, value in drawn.items()}
    return found | {f"hidden_{n}": float(place) for n, place in enumerate(places)}


def as_author(values: Arrays) -> Arrays:
    """Declared parameters [N] in the form of `draw_parameters`."""
    places = [values[f"hidden_{n}"] for n in range(PLACES)]
    own = {name: value for name, value in values.items() if not name.startswith("hidden_")}
    return own | {"hidden": np.stack(places, -1)}
