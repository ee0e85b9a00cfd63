"""The car as an MJCF model: chassis on a free joint, four sprung wheels, a floor.

The body frame sits at the tracking sensor, at the height of the centre of gravity. Visual geoms
have no mass: chassis and wheels have explicit inertias. The suspension is preloaded, so the car is
level at rest whatever its mass. Both front wheels steer by the same angle (no Ackermann).
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import mujoco
import numpy as np
from dm_control import mjcf

from buggy_rl.core.vehicle import GRAVITY, VehicleDimensions
from buggy_rl.simulators.mujoco.actuators import SHARES, Drive
from buggy_rl.simulators.mujoco.arrays import Array, array_like, indices_like
from buggy_rl.simulators.mujoco.weights import (
    WHEELS,
    Weights,
    chassis_inertia,
    hub,
    spring_reference,
)

Tyres = Literal["explicit", "contact"]
"""`explicit`: forces of floor and tyres by laws of this package; `contact`: MuJoCo's own."""

# Contact penetration is 0.1 mm under the sprung car; 1 mm with MuJoCo's default of 0.9.
CONTACT_IMPEDANCE = (0.99, 0.99, 0.001)  # [-], [-], [m] solimp
SETTLING_TIME = 3.0  # [s] time after which the car is at rest on its springs


@dataclass(frozen=True)
class CompiledCar:
    """The compiled model and the indices of its parts."""

    dimensions: VehicleDimensions
    tyres: Tyres
    root: Any
    """The `mjcf.RootElement`; its elements are generated at run time, so it has no useful type."""
    model: mujoco.MjModel
    hub_x: np.ndarray
    """[4, 1] wheel centres ahead of the sensor [m]."""
    hub_y: np.ndarray
    """[4, 1] wheel centres to the left [m]."""
    chassis: int
    """Body id."""
    wheel_bodies: np.ndarray
    """[4] body ids."""
    slide: np.ndarray
    """[4] degree of freedom of each suspension; its qpos index is one higher."""
    spin: np.ndarray
    """[4] degree of freedom of each wheel's spin; its qpos index is one higher."""
    steer: np.ndarray
    """[2] degree of freedom of each front wheel's steering; its qpos index is one higher."""
    visual: bool
    """Whether it has visual geoms."""
    drive: Drive
    """Driven wheels."""
    parked: np.ndarray
    """[nq] the car at rest at the origin, springs settled."""

    def beside(self, like: Array) -> "CompiledCar":
        """The same car with places and indices as arrays of the kind and device of `like`."""
        if isinstance(like, np.ndarray):
            return self
        places = {n: array_like(getattr(self, n), like) for n in ("hub_x", "hub_y", "parked")}
        indices = {n: indices_like(getattr(self, n), like) for n in ("slide", "spin", "steer")}
        return replace(self, **places, **indices)

    def __reduce__(self) -> tuple[Callable[..., "CompiledCar"], tuple]:
        """How a copy is made: dm_control's elements can be pickled and not be read again."""
        return make_car, (self.dimensions, self.tyres, self.timestep, self.visual, self.drive)

    @property
    def weights(self) -> Weights:
        """Wheels and suspension of this car."""
        return Weights.of(self.dimensions)

    @property
    def timestep(self) -> float:
        """Timestep of the physics [s]."""
        return self.model.opt.timestep


@lru_cache(maxsize=8)
def make_car(
    dimensions: VehicleDimensions,
    tyres: Tyres,
    timestep: float,
    visual: bool = True,
    drive: Drive = "rear",
) -> CompiledCar:
    """Builds and compiles the model; the result is cached and must not be changed.

    Args:
        dimensions: Of the car.
        tyres: `explicit` or `contact`.
        timestep: Of the physics [s].
        visual: With visual geoms, which do not change the motion; without, 15 % faster.
        drive: Driven wheels: rear, front or all.

    Raises:
        ValueError: `tyres` is neither of the two, or `drive` none of the three.
    """
    if drive not in SHARES:
        raise ValueError(f"drive is {drive!r}; expected one of {', '.join(SHARES)}")
    if tyres not in ("explicit", "contact"):
        raise ValueError(f"tyres is {tyres!r}; expected 'explicit' or 'contact'")
    root = car_mjcf(dimensions, tyres, timestep, drive)
    if not visual:
        for geom in root.find_all("geom"):
            if geom.contype == 0:
                geom.remove()
    model = mjcf.Physics.from_mjcf_model(root).model.ptr
    dof = {
        kind: np.array([model.joint(f"{kind}_{wheel}").dofadr[0] for wheel in wheels])
        for kind, wheels in (("slide", WHEELS), ("spin", WHEELS), ("steer", WHEELS[:2]))
    }
    hubs = np.array([hub(dimensions, wheel) for wheel in WHEELS])  # (4, 3)
    return CompiledCar(
        dimensions=dimensions,
        tyres=tyres,
        root=root,
        model=model,
        hub_x=hubs[:, :1],
        hub_y=hubs[:, 1:2],
        chassis=model.body("chassis").id,
        wheel_bodies=np.array([model.body(wheel).id for wheel in WHEELS]),
        **dof,
        visual=visual,
        drive=drive,
        parked=model.qpos0.copy() if tyres == "explicit" else _parked(model),
    )


def model_fields(car: CompiledCar, values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The model's fields that depend on parameters.

    Args:
        car: The model as compiled.
        values: Parameter name -> [1] or [n].

    Returns:
        Field name -> [n, ...] as `MjModel` has it, or [1, ...] where all environments share it.
    """
    inertia = chassis_inertia(
        car.dimensions, values["mass"], values["yaw_inertia"], values["cg_to_front_axle"]
    )
    names = ["body_mass", "body_ipos", "body_inertia", "qpos_spring"]
    rows = len(inertia["mass"])
    if car.tyres == "contact":
        names.append("geom_friction")
        rows = max(rows, len(values["grip_front"]), len(values["grip_rear"]))
    fields = {name: np.repeat(getattr(car.model, name)[None], rows, 0) for name in names}
    fields["body_mass"][:, car.chassis] = inertia["mass"]
    fields["body_ipos"][:, car.chassis] = inertia["ipos"]
    fields["body_inertia"][:, car.chassis] = inertia["inertia"]
    reference = spring_reference(car.weights, car.dimensions.wheelbase, values)
    fields["qpos_spring"][:, car.slide + 1] = reference.T
    if car.tyres == "contact":
        for wheel in WHEELS:
            geom = car.model.geom(f"tyre_{wheel}").id
            fields["geom_friction"][:, geom, 0] = values[f"grip_{wheel.split('_')[0]}"]
    return fields


def car_mjcf(
    dimensions: VehicleDimensions, tyres: Tyres, timestep: float, drive: Drive = "rear"
) -> Any:
    """The model as dm_control MJCF, not compiled."""
    root: Any = mjcf.RootElement(model="buggy")
    root.compiler.angle = "radian"  # mjcf compiles degrees by default
    root.option.timestep = timestep
    root.option.gravity = [0.0, 0.0, -GRAVITY]
    root.option.integrator = "implicitfast"
    root.option.cone = "elliptic"
    # A step must depend on the state in the TensorDict alone, without automatic resets.
    root.option.flag.warmstart = "disable"
    root.option.flag.autoreset = "disable"
    root.option.flag.island = "disable"  # one car is one island; finding it takes 4 % of a step
    add_scenery(root)
    chassis = root.worldbody.add("body", name="chassis", pos=[0, 0, dimensions.cg_height])
    chassis.add("freejoint", name="free")
    inertia = chassis_inertia(
        dimensions, dimensions.mass, dimensions.yaw_inertia, dimensions.cg_to_front_axle
    )
    chassis.add(
        "inertial",
        mass=float(inertia["mass"]),
        pos=inertia["ipos"].tolist(),
        diaginertia=inertia["inertia"].tolist(),
    )
    add_shell(chassis, dimensions)
    for wheel in WHEELS:
        _add_wheel(chassis, wheel, dimensions, tyres, drive)
    return root


def _add_wheel(
    chassis, wheel: str, dimensions: VehicleDimensions, tyres: Tyres, drive: Drive
) -> None:
    body = chassis.add("body", name=wheel, pos=hub(dimensions, wheel))
    weights = Weights.of(dimensions)
    nominal = {name: np.array([getattr(dimensions, name)]) for name in ("mass", "cg_to_front_axle")}
    body.add(
        "joint",
        name=f"slide_{wheel}",
        type="slide",
        axis=[0, 0, 1],
        stiffness=weights.spring_rate,
        damping=weights.spring_damping,
        armature=weights.strut_armature,
        springref=float(
            spring_reference(weights, dimensions.wheelbase, nominal)[WHEELS.index(wheel), 0]
        ),
        limited=True,
        range=[-weights.suspension_travel, weights.suspension_travel],
    )
    if wheel.startswith("front"):
        body.add(
            "joint",
            name=f"steer_{wheel}",
            type="hinge",
            axis=[0, 0, 1],
            armature=weights.steering_armature,
        )
    driven = weights.driveline_inertia if SHARES[drive][WHEELS.index(wheel)] else 0.0
    body.add("joint", name=f"spin_{wheel}", type="hinge", axis=[0, 1, 0], armature=driven)
    body.add(
        "inertial",
        pos=[0, 0, 0],
        mass=weights.wheel_mass,
        diaginertia=[weights.tilt_inertia, weights.spin_inertia, weights.tilt_inertia],
    )
    if tyres == "contact":
        _add_tyre(body, wheel, dimensions)
    add_rim(body, dimensions)


def _add_tyre(body, wheel: str, dimensions: VehicleDimensions) -> None:
    # A sphere has one contact point with a plane, under the hub at every steering and roll angle.
    body.add(
        "geom",
        name=f"tyre_{wheel}",
        type="sphere",
        size=[dimensions.wheel_radius],
        mass=0,
        priority=1,  # its friction applies, not the floor's
        solimp=CONTACT_IMPEDANCE,
        rgba=[0, 0, 0, 0],
    )


def _parked(model: mujoco.MjModel) -> np.ndarray:
    """Coordinates of a car that has settled on its contacts."""
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(SETTLING_TIME / model.opt.timestep))
    parked = data.qpos.copy()
    parked[:2] = 0.0
    return parked


def add_shell(chassis, dimensions: VehicleDimensions) -> None:
    """Geoms of the chassis, without mass and contact."""
    front = dimensions.cg_to_front_axle - dimensions.sensor_to_cg
    middle = front - dimensions.wheelbase / 2
    half_length, half_width = dimensions.length / 2, dimensions.track_width / 2
    style = dict(mass=0, contype=0, conaffinity=0)
    red, dark, wing = [0.75, 0.12, 0.1, 1], [0.15, 0.15, 0.17, 1], [0.1, 0.1, 0.1, 1]
    parts = [
        ("box", [middle, 0, -0.01], [half_length * 0.9, half_width * 0.5, 0.006], dark),
        ("box", [middle - 0.01, 0, 0.01], [half_length * 0.5, half_width * 0.42, 0.016], red),
        ("box", [middle - 0.02, 0, 0.035], [half_length * 0.22, half_width * 0.32, 0.012], dark),
        ("box", [middle + half_length * 0.7, 0, 0.0], [half_length * 0.3, 0.02, 0.009], red),
        ("box", [middle - half_length, 0, 0.045], [0.018, half_width * 0.9, 0.003], wing),
        ("box", [front, 0, -0.012], [0.005, half_width, 0.004], dark),
        ("box", [front - dimensions.wheelbase, 0, -0.012], [0.005, half_width, 0.004], dark),
        ("sphere", [0, 0, 0.05], [0.005, 0.005, 0.005], [0.3, 0.6, 1, 1]),  # tracking sensor
    ]
    for kind, pos, size, rgba in parts:
        chassis.add("geom", type=kind, pos=pos, size=size, rgba=rgba, **style)


def add_scenery(root) -> None:
    """Floor and light; only the floor and contact tyres have contact."""
    root.asset.add(
        "texture",
        name="tiles",
        type="2d",
        builtin="checker",
        rgb1=[0.32, 0.34, 0.36],
        rgb2=[0.4, 0.42, 0.44],
        width=256,
        height=256,
    )
    root.asset.add("material", name="tiles", texture="tiles", texrepeat=[1, 1], texuniform=True)
    root.worldbody.add("light", pos=[0, 0, 4], dir=[0.2, 0.1, -1])
    root.worldbody.add("geom", name="floor", type="plane", size=[20, 20, 0.1], material="tiles")


def add_rim(body, dimensions: VehicleDimensions) -> None:
    """Geoms of a wheel, on the spinning body."""
    radius, half_width = dimensions.wheel_radius, dimensions.wheel_width / 2
    style = dict(type="cylinder", euler=[np.pi / 2, 0, 0], mass=0, contype=0, conaffinity=0)
    body.add("geom", size=[radius, half_width], rgba=[0.08, 0.08, 0.08, 1], **style)
    body.add("geom", size=[0.55 * radius, 1.02 * half_width], rgba=[0.85, 0.8, 0.2, 1], **style)
    # A bolt off the axis, which shows the spin.
    body.add(
        "geom",
        pos=[0.7 * radius, 0, 0],
        size=[0.12 * radius, 1.05 * half_width],
        rgba=[0.9, 0.9, 0.9, 1],
        **style,
    )
