"""The buggy as MuJoCo geoms: body of convex meshes, wheels with tread and spokes that turn.

Lengths are fractions of the car's own: half its length, half its track width, its wheel radius.
Vertices and faces are in the part's own frame: x forward, y left, z up.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import wheels
from buggy_rl.visual.film.canvas import GHOST_TINT, RGB, mixed

Section = tuple[float, float, float, float, float]
"""x, half width at the foot, half width at the top, z of the foot, z of the top [m]."""


def hull(sections: Sequence[Section]) -> NDArray[Any]:
    """Corners [4 S, 3] of a convex part, symmetric about the xz plane, from its cross sections."""
    corners = []
    for x, foot, top, low, high in sections:
        corners += [(x, foot, low), (x, -foot, low), (x, top, high), (x, -top, high)]
    return np.array(corners)


def revolved(
    profile: Sequence[tuple[float, float]], sides: int, lugs: float = 0.0
) -> tuple[NDArray[Any], NDArray[Any]]:
    """A closed body of revolution about the y axis.

    Args:
        profile: y and radius [m], from one end to the other; both ends are closed by a disc.
        sides: Of its outline; even where there are lugs.
        lugs: Share by which every second side of the largest radius stands out.

    Returns:
        Vertices [V, 3], and faces [F, 3] that are counterclockwise seen from outside.
    """
    y, radius = np.array(profile).T  # (P,)
    angle = 2 * np.pi * np.arange(sides) / sides
    swell = np.ones((len(y), sides))
    swell[np.isclose(radius, radius.max())] += lugs * (np.arange(sides) % 2)
    ring = radius[:, None] * swell  # (P, sides)
    x, z = ring * np.cos(angle), ring * np.sin(angle)
    tube = np.stack([x, np.broadcast_to(y[:, None], x.shape), z], -1).reshape(-1, 3)
    ends = np.array([[0.0, y[0], 0.0], [0.0, y[-1], 0.0]])
    side = np.arange(sides)
    after = (side + 1) % sides
    faces = []
    for row in range(len(y) - 1):
        a, b = row * sides + side, row * sides + after
        c, d = a + sides, b + sides
        faces += [np.stack([a, c, b], 1), np.stack([b, c, d], 1)]
    first, last = len(tube), len(tube) + 1
    tail = (len(y) - 1) * sides
    faces.append(np.stack([np.full(sides, first), side, after], 1))
    faces.append(np.stack([np.full(sides, last), tail + after, tail + side], 1))
    return np.concatenate([tube, ends]), np.concatenate(faces)


# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.


Tint = Callable[[RGB], RGB]
SPOKES = 5
SIDES = 36  # of a wheel's outline; every second pair bears a lug
DARK, GLASS, RIM, TYRE = (
    (0.13, 0.14, 0.16),
    (0.10, 0.13, 0.18),
    (0.86, 0.87, 0.88),
    (0.09, 0.09, 0.09),
)
LAMP, TAIL, STRIPE = (1.0, 0.97, 0.82), (0.55, 0.04, 0.05), (0.97, 0.97, 0.95)

# Cross sections: x, half width at foot and top, z of foot and top, in the fractions above.
PARTS: dict[str, tuple[RGB | None, list[Section]]] = {  # None is the car's own colour
    "pan": (DARK, [(-0.92, 0.34, 0.42, 0.62, 0.95), (0.95, 0.24, 0.26, 0.66, 0.9)]),
    "bumper": (DARK, [(0.9, 0.5, 0.46, 0.62, 0.98), (1.0, 0.42, 0.36, 0.66, 0.92)]),
    "nose": (None, [(0.1, 0.46, 0.4, 0.8, 1.72), (0.62, 0.32, 0.26, 0.8, 1.36),
                    (0.94, 0.2, 0.16, 0.82, 1.05)]),
    "pods": (None, [(-0.42, 0.66, 0.5, 0.7, 1.3), (0.2, 0.62, 0.44, 0.7, 1.22)]),
    "deck": (None, [(-0.95, 0.26, 0.2, 1.0, 1.5), (-0.6, 0.44, 0.34, 0.8, 1.76),
                    (0.12, 0.48, 0.4, 0.8, 1.74)]),
    "cabin": (GLASS, [(-0.62, 0.36, 0.28, 1.7, 1.76), (-0.36, 0.38, 0.26, 1.7, 2.42),
                      (-0.04, 0.38, 0.26, 1.7, 2.42), (0.3, 0.34, 0.3, 1.62, 1.7)]),
    "roof": (None, [(-0.42, 0.29, 0.24, 2.38, 2.5), (0.0, 0.29, 0.24, 2.38, 2.5)]),
    "stripe": (STRIPE, [(0.28, 0.1, 0.1, 1.5, 1.665), (0.62, 0.085, 0.085, 1.2, 1.39),
                        (0.9, 0.07, 0.07, 0.95, 1.105)]),
    "wing": (None, [(-1.06, 0.84, 0.84, 2.5, 2.58), (-0.74, 0.84, 0.84, 2.3, 2.4)]),
}  # fmt: skip


@dataclass(frozen=True)
class Scale:
    """What the fractions are of, and the middle between the axles [m]."""

    middle: float
    axle: float
    """Half the wheelbase, as a fraction of half the length."""
    length: float
    width: float
    radius: float

    @classmethod
    def of(cls, dimensions: VehicleDimensions) -> "Scale":
        """Half length, half track width and wheel radius."""
        front, rear = wheels.places(dimensions)[[0, 2], 0]
        half_length, half_width = dimensions.length / 2, dimensions.track_width / 2
        axle = (front - rear) / dimensions.length
        return cls((front + rear) / 2, axle, half_length, half_width, dimensions.wheel_radius)

    def point(self, x: float, y: float, z: float) -> list[float]:
        """Converts a point from fractions to metres in the body frame."""
        return [self.middle + x * self.length, y * self.width, z * self.radius]

    def section(self, section: Section) -> Section:
        """Converts a section from fractions to metres in the body frame."""
        x, foot, top, low, high = section
        width, radius = self.width, self.radius
        along = self.middle + x * self.length
        return along, foot * width, top * width, low * radius, high * radius


def add_meshes(spec: mujoco.MjSpec, dimensions: VehicleDimensions) -> None:
    """The shapes that all cars of a scene share."""
    scale = Scale.of(dimensions)
    for name, (_, sections) in PARTS.items():
        vertices = hull([scale.section(section) for section in sections])
        spec.add_mesh(name=name, uservert=vertices.flatten())
    radius, half = dimensions.wheel_radius, dimensions.wheel_width / 2
    tread = [(-1.0, 0.62), (-1.0, 0.84), (-0.72, 0.96), (0.72, 0.96), (1.0, 0.84), (1.0, 0.62)]
    profile = [(y * half, r * radius) for y, r in tread]
    vertices, faces = revolved(profile, SIDES, lugs=0.04 / 0.96)
    spec.add_mesh(name="tyre", uservert=vertices.flatten(), userface=faces.flatten())


def add_car(
    spec: mujoco.MjSpec, name: str, paint: RGB, alpha: float, dimensions: VehicleDimensions
) -> None:
    """A mocap body with two hinges for steering and four for rolling, named `NAME_...`."""
    share = GHOST_TINT if alpha < 1 else 0.0
    body = spec.worldbody.add_body(name=name, mocap=True)

    def tinted(colour: RGB) -> RGB:
        return mixed(colour, paint, share)

    for part, (colour, _) in PARTS.items():
        _geom(body, "mesh", tinted(colour or paint), alpha, meshname=part)
    _add_details(body, Scale.of(dimensions), tinted, alpha)
    for place, (x, y) in zip(wheels.PLACES, wheels.places(dimensions), strict=True):
        hub = body.add_body(name=f"{name}_{place}_hub", pos=[x, y, dimensions.wheel_radius])
        _weigh(hub)
        if place.startswith("front"):
            hub.add_joint(name=f"{name}_{place}_steer", axis=[0, 0, 1])
        wheel = hub.add_body(name=f"{name}_{place}")
        _weigh(wheel)
        wheel.add_joint(name=f"{name}_{place}_roll", axis=[0, 1, 0])
        _add_wheel(wheel, tinted, alpha, dimensions, float(np.sign(y)))


def _add_details(body, scale: Scale, tinted: Tint, alpha: float) -> None:
    """Suspension, struts and end plates of the wing, lamps."""
    length, width, radius = scale.length, scale.width, scale.radius

    def box(x, y, z, half, colour):
        size = [half[0] * length, half[1] * width, half[2] * radius]
        _geom(body, "box", tinted(colour), alpha, pos=scale.point(x, y, z), size=size)

    for x in (scale.axle, -scale.axle):
        for shift in (-0.07, 0.07):
            box(x + shift, 0, 0.9, (0.018, 0.86, 0.06), DARK)
        box(x, 0, 1.5, (0.02, 0.5, 0.24), DARK)
    for side in (-1, 1):
        box(-0.88, 0.26 * side, 1.95, (0.045, 0.025, 0.45), DARK)
        box(-0.9, 0.86 * side, 2.42, (0.19, 0.02, 0.26), DARK)
        _geom(body, "ellipsoid", tinted(LAMP), alpha, pos=scale.point(0.84, 0.15 * side, 1.08),
              size=[0.05 * length, 0.06 * width, 0.11 * radius])  # fmt: skip
        box(-0.95, 0.14 * side, 1.32, (0.02, 0.07, 0.07), TAIL)


def _add_wheel(
    body, tinted: Tint, alpha: float, dimensions: VehicleDimensions, side: float
) -> None:
    """Tyre, and on the outer side a dish with spokes."""
    radius, half = dimensions.wheel_radius, dimensions.wheel_width / 2
    _geom(body, "mesh", tinted(TYRE), alpha, meshname="tyre")
    lying = [np.sqrt(0.5), np.sqrt(0.5), 0, 0]  # the cylinder's z onto y
    face = side * half
    dish = dict(quat=lying, pos=[0, 0.52 * face, 0])
    _geom(body, "cylinder", tinted(DARK), alpha, size=[0.63 * radius, 0.5 * half, 0], **dish)
    for spoke in range(SPOKES):
        angle = 2 * np.pi * spoke / SPOKES
        where = [0.34 * radius * np.cos(angle), 1.03 * face, -0.34 * radius * np.sin(angle)]
        turn = [np.cos(angle / 2), 0, np.sin(angle / 2), 0]
        _geom(body, "box", tinted(RIM), alpha, pos=where, quat=turn,
              size=[0.28 * radius, 0.06 * half, 0.085 * radius])  # fmt: skip
    hub = dict(quat=lying, pos=[0, 1.04 * face, 0])
    _geom(body, "cylinder", tinted(RIM), alpha, size=[0.15 * radius, 0.12 * half, 0], **hub)


def _weigh(body) -> None:
    """A mass, which MuJoCo wants of what a joint moves; it moves nothing here."""
    body.explicitinertial, body.mass, body.inertia = True, 0.1, [1e-4] * 3


def _geom(body, kind: str, colour: RGB, alpha: float, **where) -> None:
    """A geom that touches nothing."""
    type_ = getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}")
    body.add_geom(type=type_, rgba=[*colour, alpha], contype=0, conaffinity=0, **where)
