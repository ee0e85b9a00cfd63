"""The scene: a floor, the cars and, drawn anew in each frame, paths and waypoints. No physics."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from buggy_rl.vehicle import VehicleDimensions
from buggy_rl.viz.film.bodywork import car_body, car_meshes
from buggy_rl.viz.film.colours import Colour
from buggy_rl.viz.film.track import Row

WORLD = """
<mujoco model="film">
  <compiler angle="radian" autolimits="true"/>
  <option gravity="0 0 0"/>
  <statistic extent="1.5"/>
  <visual>
    <global offwidth="{width}" offheight="{height}"/>
    <headlight ambient="0.42 0.42 0.42" diffuse="0.2 0.2 0.2" specular="0 0 0"/>
    <quality offsamples="4"/>
    <map znear="0.02" zfar="40" haze="0.35"/>
    <rgba haze="0.80 0.85 0.90 1"/>
  </visual>
  <default><geom contype="0" conaffinity="0" mass="0"/></default>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.50 0.64 0.80"
             rgb2="0.84 0.89 0.94" width="128" height="768"/>
    <texture name="tiles" type="2d" builtin="flat" rgb1="0.60 0.62 0.64" mark="edge"
             markrgb="0.48 0.50 0.53" width="160" height="160"/>
    <material name="tiles" texture="tiles" texrepeat="1 1" texuniform="true"/>
    {meshes}
  </asset>
  <worldbody>
    <light pos="0 0 5" dir="0.3 0.25 -1" directional="true" castshadow="false"
           diffuse="0.6 0.6 0.58" specular="0.1 0.1 0.1"/>
    <geom type="plane" size="60 60 0.1" material="tiles"/>
    {cars}
  </worldbody>
</mujoco>
"""


@dataclass(frozen=True)
class Look:
    """How a car is shown."""

    colour: Colour
    alpha: float = 1.0


class Scene:
    """A MuJoCo model of cars without physics, each set to a row of its track.

    Args:
        looks: Of each car.
        dimensions: Of all cars.
        size: Width and height of the frames [pixels].
    """

    def __init__(
        self,
        looks: Sequence[Look],
        dimensions: VehicleDimensions | None = None,
        size: tuple[int, int] = (640, 480),
    ) -> None:
        self.dimensions = dimensions or VehicleDimensions()
        bodies = [
            car_body(_name(i), self.dimensions, " ".join(map(str, look.colour)), look.alpha)
            for i, look in enumerate(looks)
        ]
        world = WORLD.format(
            meshes=car_meshes(self.dimensions),
            cars="\n".join(bodies),
            width=size[0],
            height=size[1],
        )
        self.model = mujoco.MjModel.from_xml_string(world)
        self.data = mujoco.MjData(self.model)
        self.looks = list(looks)

    def set(self, rows: Sequence[Row]) -> None:
        """Puts each car where its row has it, wheels steered and rolled."""
        for index, row in enumerate(rows):
            name = _name(index)
            x, y, yaw = row.pose
            adr = self.model.joint(name).qposadr[0]
            quaternion = [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
            self.data.qpos[adr : adr + 7] = [x, y, 0.0, *quaternion]
            for side in ("left", "right"):
                self._turn(f"{name}_steer_front_{side}", row.wheel_angle)
                for axle in ("front", "rear"):
                    self._turn(f"{name}_roll_{axle}_{side}", row.roll)
        mujoco.mj_forward(self.model, self.data)

    def _turn(self, joint: str, angle: float) -> None:
        self.data.qpos[self.model.joint(joint).qposadr[0]] = angle


def _name(index: int) -> str:
    return f"car_{index}"
