"""Sensors that sit elsewhere on the car, or whose readings are off by a factor or a bias."""

import math
import random
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy import ndarray

from buggy_rl.proof.real.edits.base import DIGITS, Edit, LogRows, log_uniform, ratio, signed


class SensorLeverArmEdit(Edit):
    """Another point of the car: position + R(yaw) (x, y); vx - y r, vy + x r."""

    name: ClassVar[str] = "sensor_lever_arm"
    mechanism: ClassVar[str] = "sensor place"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        length, way = log_uniform(chance, 0.005, 0.1), chance.uniform(-math.pi, math.pi)
        x, y = length * math.cos(way), length * math.sin(way)
        return {"x": round(x, DIGITS), "y": round(y, DIGITS)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        x, y, yaw, rate = values["x"], values["y"], rows.pose[:, 2], rows.velocity[:, 2]
        cos, sin = np.cos(yaw), np.sin(yaw)
        moved = np.stack([x * cos - y * sin, x * sin + y * cos, np.zeros(len(rows))], -1)
        shifted = np.stack([-y * rate, x * rate, np.zeros(len(rows))], -1)
        return replace(rows, pose=rows.pose + moved, velocity=rows.velocity + shifted)


class SensorYawEdit(Edit):
    """A sensor that is turned on the car: yaw + angle; R(-angle) (vx, vy)."""

    name: ClassVar[str] = "sensor_yaw"
    mechanism: ClassVar[str] = "sensor direction"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"angle": signed(chance, log_uniform(chance, 0.003, 0.15))}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        cos, sin = math.cos(values["angle"]), math.sin(values["angle"])
        vx, vy, rate = rows.velocity.T
        velocity = np.stack([cos * vx + sin * vy, -sin * vx + cos * vy, rate], -1)
        return replace(rows, pose=rows.pose + np.array([0, 0, values["angle"]]), velocity=velocity)


class SpeedScaleEdit(Edit):
    """Speeds that are off by a factor, and positions that are right."""

    name: ClassVar[str] = "speed_scale"
    mechanism: ClassVar[str] = "sensor scale"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"ratio": ratio(chance, 0.005, 0.15)}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        return replace(rows, velocity=rows.velocity * _of_speeds(values["ratio"]))


class GyroBiasEdit(Edit):
    """A yaw rate that is off by a bias, and a heading that is right."""

    name: ClassVar[str] = "gyro_bias"
    mechanism: ClassVar[str] = "sensor bias"

    def drawn(self, chance: random.Random) -> dict[str, float]:
        return {"bias": signed(chance, log_uniform(chance, 0.005, 0.2))}

    def edited(self, rows: LogRows, values: Mapping[str, float]) -> LogRows:
        return replace(rows, velocity=rows.velocity + np.array([0, 0, values["bias"]]))


def _of_speeds(factor: float) -> ndarray:
    return np.array([factor, factor, 1.0])
