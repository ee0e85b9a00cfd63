"""Parameters with the values of a preset, or scaled to another car."""

import importlib.resources
from collections.abc import Mapping, Sequence

import yaml

from buggy_rl.engines import speed_control, two_way
from buggy_rl.parameters import Parameter
from buggy_rl.similarity import Similarity
from buggy_rl.vehicle import VehicleDimensions


def declare(
    preset: str,
    rows: Sequence[tuple],
    dimensions: VehicleDimensions | None = None,
    speed_ratio: float | None = None,
) -> list[Parameter]:
    """Parameters with the values of a preset, or those of another car that is similar to it.

    Args:
        preset: A file in `presets/`, without its ending.
        rows: Name, lower bound, upper bound, unit and meaning of each; bounds are the buggy's.
        dimensions: Of the other car.
        speed_ratio: Of its speeds to the buggy's; see `Similarity`.

    Raises:
        ValueError: There is no such preset, or it leaves a parameter out.
    """
    folder = importlib.resources.files("buggy_rl.engines") / "presets"
    file = folder / f"{preset}.yaml"
    if not file.is_file():
        available = sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".yaml"))
        raise ValueError(f"no preset {preset!r}; available: {', '.join(available)}")
    values = (
        two_way.SHIPPED | speed_control.SHIPPED | yaml.safe_load(file.read_text())["parameters"]
    )
    missing = [row[0] for row in rows if row[0] not in values]
    if missing:
        raise ValueError(f"preset {preset!r} leaves out {', '.join(missing)}: add them to {file}")
    values = {row[0]: float(values[row[0]]) for row in rows}
    if dimensions is None:
        return [Parameter(row[0], values[row[0]], *row[1:]) for row in rows]
    return _similar(values, rows, dimensions, speed_ratio)


def _similar(
    values: Mapping[str, float],
    rows: Sequence[tuple],
    car: VehicleDimensions,
    speed_ratio: float | None,
) -> list[Parameter]:
    """Bounds scaled from the buggy, values from the preset's car; dimensions are the car's own."""
    wheelbase = values["cg_to_front_axle"] + values["cg_to_rear_axle"]
    preset = VehicleDimensions(wheelbase=round(wheelbase, 6), mass=values["mass"])
    to_buggy = Similarity.between(car, speed=speed_ratio)
    speed = to_buggy.speed / Similarity.between(preset).speed
    to_preset = Similarity.between(car, preset, speed)
    own = {
        "mass": car.mass,
        "yaw_inertia": car.yaw_inertia,
        "cg_to_front_axle": car.cg_to_front_axle,
        "cg_to_rear_axle": round(car.cg_to_rear_axle, 9),
        "sensor_x": car.sensor_to_cg,
    }
    result = []
    for name, lower, upper, unit, meaning in rows:
        value, bound = own.get(name, to_preset.of(unit) * values[name]), to_buggy.of(unit)
        result.append(Parameter(name, value, bound * lower, bound * upper, unit, meaning))
    return result
