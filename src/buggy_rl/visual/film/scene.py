"""MuJoCo's model of a film: floor, light, sky and one to three cars that a shot puts in place."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import wheels
from buggy_rl.visual.film.bodywork import add_car, add_meshes
from buggy_rl.visual.film.canvas import CAR, FLOOR, GHOST_ALPHA, GHOSTS, GRID, RGB, SKY
from buggy_rl.visual.film.drawing import SUN
from buggy_rl.visual.film.shot import Shot, ShownCar

ALPHAS = (1.0, GHOST_ALPHA, GHOST_ALPHA)
NAMES = ("car", "ghost", "ghost_2")


class Scene:
    """Takes shots; renderers and MuJoCo's viewer read `model` and `data`.

    Args:
        dimensions: Of all cars.
        size: Width and height of the picture [pixel].
        ghosts: Number of translucent cars.
        samples: Of each pixel against jagged edges.
    """

    def __init__(
        self,
        dimensions: VehicleDimensions,
        size: tuple[int, int] = (640, 480),
        ghosts: int = 0,
        samples: int = 4,
    ) -> None:
        spec = mujoco.MjSpec()
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        _set_visual(spec, size, samples)
        _add_surroundings(spec)
        add_meshes(spec, dimensions)
        self.names = NAMES[: 1 + ghosts]
        for name, paint, alpha in zip(self.names, (CAR, *GHOSTS), ALPHAS, strict=False):
            add_car(spec, name, paint, alpha, dimensions)
        self.model: mujoco.MjModel = spec.compile()
        self.data = mujoco.MjData(self.model)
        self._mocap = [int(self.model.body(name).mocapid[0]) for name in self.names]
        self._roll = [self._joints(name, "roll", wheels.PLACES) for name in self.names]
        self._steer = [self._joints(name, "steer", wheels.PLACES[:2]) for name in self.names]

    def place(self, shot: Shot) -> None:
        """Puts the cars where a shot has them, wheels steered and rolled.

        Raises:
            ValueError: The shot has another number of cars than the scene.
        """
        if len(shot.cars) != len(self.names):
            raise ValueError(
                f"a shot with {len(shot.cars)} cars for a scene of {len(self.names)}: make the "
                f"scene with ghosts={len(shot.ghosts)}"
            )
        for index, car in enumerate(shot.cars):
            self._place(index, car)
        mujoco.mj_forward(self.model, self.data)

    def binary(self) -> bytes:
        """The compiled model, for a renderer in another process."""
        content = np.empty(mujoco.mj_sizeModel(self.model), np.uint8)
        mujoco.mj_saveModel(self.model, None, content)
        return content.tobytes()

    def _place(self, index: int, car: ShownCar) -> None:
        body, data = self._mocap[index], self.data
        data.mocap_pos[body] = car.x, car.y, 0.0
        data.mocap_quat[body] = np.cos(car.yaw / 2), 0.0, 0.0, np.sin(car.yaw / 2)
        data.qpos[self._steer[index]] = car.steering_angle
        data.qpos[self._roll[index]] = np.remainder(car.roll, 2 * np.pi)

    def _joints(self, name: str, what: str, places: tuple[str, ...]) -> NDArray[Any]:
        """Addresses in qpos."""
        joints = [self.model.joint(f"{name}_{place}_{what}") for place in places]
        return np.array([int(joint.qposadr[0]) for joint in joints])


def _set_visual(spec: mujoco.MjSpec, size: tuple[int, int], samples: int) -> None:
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = size
    visual.quality.offsamples, visual.quality.shadowsize = samples, 0
    visual.quality.numslices, visual.quality.numstacks = 16, 8  # of ellipsoids and cylinders
    visual.headlight.ambient, visual.headlight.diffuse = [0.42] * 3, [0.2] * 3
    visual.headlight.specular = [0.0] * 3
    visual.map.znear, visual.map.zfar = 0.01, 40.0
    visual.rgba.haze = [*SKY, 1.0]
    spec.stat.extent, spec.stat.center = 1.0, [0.0, 0.0, 0.0]


def _add_surroundings(spec: mujoco.MjSpec) -> None:
    """A floor with a line every metre, a hazy sky and a sun."""
    texture = mujoco.mjtTexture
    _add_texture(spec, "sky", texture.mjTEXTURE_SKYBOX, SKY, (0.62, 0.75, 0.9),
                 builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, width=256, height=256)  # fmt: skip
    _add_texture(spec, "floor", texture.mjTEXTURE_2D, FLOOR, FLOOR,
                 builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, mark=mujoco.mjtMark.mjMARK_EDGE,
                 markrgb=list(GRID), width=256, height=256)  # fmt: skip
    material = spec.add_material(name="floor", texrepeat=[1, 1], texuniform=True)
    material.specular, material.shininess = 0.1, 0.1
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1],
                            material="floor", contype=0, conaffinity=0)  # fmt: skip
    # Shadows are marks: shadow maps flicker on a large floor and take half of the time in software.
    spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, pos=[0, 0, 4],
                             dir=[*SUN, -1], diffuse=[0.62] * 3, specular=[0.25] * 3,
                             castshadow=False)  # fmt: skip


def _add_texture(spec: mujoco.MjSpec, name: str, kind, first: RGB, second: RGB, **rest) -> None:
    spec.add_texture(name=name, type=kind, rgb1=list(first), rgb2=list(second), **rest)
