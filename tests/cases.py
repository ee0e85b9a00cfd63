"""Drives of reference cars in which something is concealed, one car an effect.

The sizes are those of an effect that a driver clearly feels; they are nobody's prior. What is
concealed acts in the car's own physics or in its camera, and shares no code with the effects that
shall find it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from tensordict import TensorDict

from buggy_rl.camera import Camera, CameraConfig
from buggy_rl.drivers.recording import driven
from buggy_rl.drivers.room import RoomDriver
from buggy_rl.engines.reference import ReferenceEngine
from buggy_rl.engines.reference.faults import NEUTRAL
from buggy_rl.recordings import Recording
from buggy_rl.vehicle import CONTROL_PERIOD

# effect -> parameter -> range of its size, and whether it has a sign that is drawn too
SIZES: dict[str, dict[str, tuple[float, float, bool]]] = {
    "throttle_dead_time": {"dead_time": (0.04, 0.12, False)},
    "steering_dead_time": {"dead_time": (0.03, 0.1, False)},
    "throttle_lag": {"time_constant": (0.08, 0.25, False)},
    "steering_lag": {"time_constant": (0.05, 0.15, False)},
    "steering_rate_limit": {"rate": (2.0, 4.0, False)},
    "throttle_gain": {"gain": (0.75, 0.9, False)},
    "steering_gain": {"gain": (0.75, 0.9, False)},
    "throttle_offset": {"offset": (0.05, 0.12, True)},
    "steering_offset": {"offset": (0.05, 0.15, True)},
    "throttle_deadband": {"width": (0.04, 0.1, False)},
    "steering_backlash": {"width": (0.1, 0.25, False)},
    "steering_asymmetry": {"left_to_right": (0.7, 0.87, False)},
    "battery_sag": {"loss_per_minute": (0.15, 0.4, False)},
    "aerodynamic_drag": {"coefficient": (0.05, 0.15, False)},
    "rolling_resistance": {"deceleration": (0.2, 0.5, False)},
    "viscous_drag": {"rate": (0.12, 0.35, False)},
    "cornering_drag": {"coefficient": (0.08, 0.25, False)},
    "floor_slope": {"along_x": (0.15, 0.4, True), "along_y": (0.15, 0.4, True)},
    "wind": {"force_x": (0.15, 0.4, True), "force_y": (0.15, 0.4, True)},
    "one_sided_drag": {"yaw_acceleration": (6.0, 14.0, True)},
    "yaw_damping": {"rate": (3.0, 8.0, False)},
    "tire_grip": {"grip": (0.55, 0.8, False)},
    "grip_balance": {"front_to_rear": (0.7, 0.85, False)},
    "grip_patch": {
        "x": (0.0, 1.5, True),
        "y": (0.0, 1.5, True),
        "radius": (1.0, 1.6, False),
        "grip": (0.3, 0.55, False),
    },
    "payload": {"mass_ratio": (1.15, 1.5, False)},
    "motor_power_limit": {"power_per_mass": (2.0, 4.0, False)},
    "top_speed": {"speed_ratio": (0.45, 0.7, False)},
    "sensor_latency": {"dead_time": (0.02, 0.06, False)},
    "sensor_lag": {"time_constant": (0.03, 0.08, False)},
    "sensor_yaw": {"angle": (0.03, 0.1, True)},
    "sensor_lever_arm": {"x": (0.03, 0.08, True), "y": (0.02, 0.06, True)},
    "speed_scale": {"ratio": (0.9, 0.96, False)},
    "gyro_bias": {"bias": (0.05, 0.2, True)},
}
UNKNOWN_SIZES: dict[str, dict[str, tuple[float, float, bool]]] = {
    "sticky_servo": {"breakaway": (0.15, 0.3, False)},
    "bump_steer": {"angle": (0.008, 0.016, True)},
    "wheel_wobble": {"angle": (0.05, 0.12, False)},
    "drag_brake": {"share": (0.15, 0.5, False)},
    "heating_motor": {"rise": (0.005, 0.015, False)},
    "loose_differential": {"time_constant": (0.08, 0.2, False)},
}
CAMERA = {  # where a sensing effect is an error of the camera
    "sensor_latency": {"dead_time": "latency"},
    "sensor_lag": {"time_constant": "lag"},
    "sensor_yaw": {"angle": "yaw"},
    "sensor_lever_arm": {"x": "lever_arm_x", "y": "lever_arm_y"},
    "speed_scale": {"ratio": "speed_scale"},
    "gyro_bias": {"bias": "gyro_bias"},
}


@dataclass(frozen=True)
class Case:
    """What is concealed in one car; nothing under the name `nothing`."""

    name: str
    parameters: dict[str, float] = field(default_factory=dict)

    @property
    def known(self) -> bool:
        """Whether the textbook has a name for it."""
        return self.name in SIZES

    def camera(self, quality: CameraConfig) -> CameraConfig:
        """The camera with what is wrong with it."""
        errors = CAMERA.get(self.name, {})
        wrong = {errors[name]: v for name, v in self.parameters.items() if name in errors}
        return replace(quality, **wrong)


@dataclass(frozen=True)
class Drives:
    """What is to be seen of a case."""

    case: Case
    train: list[Recording]
    held_out: list[Recording]


NOTHING = Case("nothing")


def draw(seed: int, names: Sequence[str] = (*SIZES, *UNKNOWN_SIZES)) -> list[Case]:
    """One case for each name, with sizes of its own; `nothing` has none."""
    sizes = SIZES | UNKNOWN_SIZES | {"nothing": {}}
    generator = torch.Generator().manual_seed(seed)
    cases = []
    for name in names:
        parameters = {}
        for parameter, (low, high, signed) in sizes[name].items():
            share, side = torch.rand(2, generator=generator).tolist()
            size = low + (high - low) * share
            parameters[parameter] = round(-size if signed and side < 0.5 else size, 4)
        cases.append(Case(name, parameters))
    return cases


def concealing(cases: Sequence[Case], cars: int = 1) -> ReferenceEngine:
    """The cars of all cases as one batch, `cars` alike of each."""
    count = len(cases) * cars
    faults: dict[str, torch.Tensor] = {}
    for index, case in enumerate(cases):
        for parameter, value in case.parameters.items():
            name = f"{case.name}.{parameter}"
            if name in NEUTRAL:
                rows = faults.setdefault(name, torch.full((count,), NEUTRAL[name]))
                rows[index * cars : (index + 1) * cars] = value
    return ReferenceEngine(count).with_faults(TensorDict(faults, [count]))


@torch.no_grad()
def make_drives(
    cases: Sequence[Case],
    seed: int = 0,
    seconds: float = 45.0,
    train: int = 2,
    held_out: int = 1,
    quality: CameraConfig | None = None,
) -> list[Drives]:
    """Drives every case about a room, all at once, and measures it; one seed, one answer."""
    cars = train + held_out
    engine = concealing(cases, cars)
    rows = list(driven(engine, RoomDriver(seed=seed), round(seconds / CONTROL_PERIOD)))
    true = TensorDict.stack(rows, 1)  # (N, T)
    result = []
    for index, case in enumerate(cases):
        recordings = []
        for car in range(cars):
            place = index * cars + car
            camera = Camera(case.camera(quality or CameraConfig()), seed * 100_003 + place)
            data = camera.recorded(true[place])
            recordings.append(Recording(f"drive_{place:03d}", data, CONTROL_PERIOD))
        result.append(Drives(case, recordings[:train], recordings[train:]))
    return result
