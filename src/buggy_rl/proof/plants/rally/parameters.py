"""Plausible parameters of 1:10 electric buggies."""

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Arrays

# Standard cars draw uniformly between these bounds; the reasons are in draw_parameters.
RANGES: dict[str, tuple[float, float]] = {
    "wheelbase": (0.18, 0.34),
    "front_share": (0.40, 0.52),
    "track_ratio": (0.70, 0.90),
    "height_ratio": (0.17, 0.27),
    "yaw_gyration": (0.40, 0.52),
    "roll_gyration": (0.28, 0.36),
    "pitch_gyration": (0.34, 0.44),
    "radius": (0.030, 0.044),
    "wheel_mass": (0.05, 0.09),
    "heave_frequency": (3.5, 6.0),
    "damping_ratio": (0.35, 0.7),
    "grip": (0.55, 1.1),
    "rear_grip": (1.0, 1.12),
    "slide_ratio": (0.75, 0.95),
    "stribeck_speed": (1.0, 3.0),
    "load_fall": (0.05, 0.2),
    "patch_length": (0.022, 0.036),
    "stiffness_x": (10.0, 18.0),
    "stiffness_y": (7.0, 13.0),
    "bristle_damping_ratio": (0.2, 0.4),
    "coupling": (0.0005, 0.004),
    "top_speed": (4.0, 8.0),
    "volts": (7.2, 8.2),
    "motor_constant": (0.0025, 0.006),
    "stall_acceleration": (5.0, 10.0),
    "battery_part": (0.15, 0.4),
    "rotor_inertia": (3e-6, 9e-6),
    "rotor_friction": (0.01, 0.03),
    "capacity": (2.0, 5.0),
    "esc_lag": (0.008, 0.03),
    "throttle_dead_time": (0.01, 0.03),
    "steering_dead_time": (0.01, 0.03),
    "lock": (0.35, 0.45),
    "servo_lag": (0.02, 0.05),
    "servo_rate": (4.0, 9.0),
    "slack": (0.0, 0.01),
    "ackermann": (0.5, 1.0),
    "rolling": (0.012, 0.035),
    "drag_area": (0.01, 0.03),
}


def draw_parameters(rng: np.random.Generator, cars: int) -> Arrays:
    """Draw one parameter set per car: name -> array [cars] ("hidden": [cars, 8]).

    mass 1.5 to 4 kg (triangular, most often 2.5 kg: bare chassis to full sensor load);
    wheelbase 0.18 to 0.34 m (short kits to truggies); front_share 0.40 to 0.52, weight on the
    front axle (battery and motor sit behind the middle); track_ratio 0.70 to 0.90 wheelbases;
    height_ratio 0.17 to 0.27 wheelbases, height of the centre of gravity (about 0.055 m);
    yaw, roll, pitch gyration radii: 0.40 to 0.52 wheelbases, 0.28 to 0.36 tracks, 0.34 to 0.44
    wheelbases (a flat plate with masses near the axles); radius 0.030 to 0.044 m (buggy tyres);
    wheel_mass 0.05 to 0.09 kg (tyre, foam, rim; inertia 0.75 m r^2 as mass sits outside);
    heave_frequency 3.5 to 6 Hz and damping_ratio 0.35 to 0.7 (oil dampers of such cars);
    grip 0.55 to 1.1 (dusty wood to carpet); rear_grip 1.0 to 1.12 times the front (setups are
    chosen to understeer); slide_ratio 0.75 to 0.95 and stribeck_speed 1 to 3 m/s (rubber loses
    some friction when it slides); load_fall 0.05 to 0.2 loss of grip when the load doubles;
    patch_length 0.022 to 0.036 m (chord of the flattened tyre); stiffness_x 10 to 18 and
    stiffness_y 7 to 13: slip stiffness over load, as of real tyres; bristle_damping_ratio 0.2 to
    0.4 of critical, of the wheel on its bristles at standstill (rubber loss factor);
    four_wheel 0 or 1 (half of the cars), front_drive 0.35 to 0.5 share of torque there;
    coupling 0.0005 to 0.004 N m s viscous differential (thin to thick silicone oil);
    top_speed 4 to 8 m/s (sets the gear ratio); volts 7.2 to 8.2 (two lithium cells);
    motor_constant 0.0025 to 0.006 V s (1600 to 3800 rpm/V); stall_acceleration 5 to 10 m/s^2
    (with the gear it sets the resistance, of winding and current-limiting controller together);
    battery_part 0.15 to 0.4 of it lies in battery and leads; rotor_inertia 3e-6 to 9e-6 kg m^2
    (size 380 to 540); rotor_friction 1 to 3 % of the stall torque; capacity 2 to 5 A h;
    esc_lag 8 to 30 ms; dead times 10 to 30 ms (radio frame and signal period);
    lock 0.35 to 0.45 rad; servo_lag 20 to 50 ms; servo_rate 4 to 9 rad/s at the wheels (servo
    of 0.08 to 0.17 s for 60 degrees); slack 0 to 0.01 rad; ackermann 0.5 to 1;
    rolling 0.012 to 0.035 (soft tyres on hard floor to carpet); drag_area 0.01 to 0.03 m^2;
    hidden: eight numbers in [0, 1) that place the unknown effects (phases, directions).
    """
    drawn = {name: rng.uniform(low, high, cars) for name, (low, high) in RANGES.items()}
    drawn["mass"] = rng.triangular(1.5, 2.5, 4.0, cars)
    drawn["four_wheel"] = (rng.random(cars) < 0.5).astype(float)
    drawn["front_drive"] = rng.uniform(0.35, 0.5, cars)
    drawn["hidden"] = rng.random((cars, 8))
    return drawn
