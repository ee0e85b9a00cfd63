"""The car of the films as plain meshes: one set of parts for each body that moves by itself."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import trimesh
from numpy.typing import NDArray

from buggy_rl.vehicle import VehicleDimensions
from buggy_rl.viz.film import wheels
from buggy_rl.viz.film.colours import MOST_GHOSTS
from buggy_rl.viz.film.scene import Scene

BODIES = ("", *(f"_{place}_hub" for place in wheels.PLACES), *(f"_{p}" for p in wheels.PLACES))
"""Behind the car's name: the car itself, hubs that steer, wheels that roll."""


@dataclass(frozen=True)
class Part:
    """A mesh of one colour in the frame of its body."""

    vertices: NDArray[Any]
    """[V, 3] m"""
    faces: NDArray[Any]
    """[F, 3]"""
    colour: tuple[int, int, int]
    """0..255"""
    alpha: float
    """1 is opaque."""


def parts(dimensions: VehicleDimensions, name: str = "car") -> dict[str, list[Part]]:
    """Parts by body (`BODIES`) of the car, or of a ghost."""
    model = Scene(dimensions, ghosts=MOST_GHOSTS).model
    return {body: _parts_of(model, model.body(name + body).id) for body in BODIES}


def _parts_of(model: mujoco.MjModel, body: int) -> list[Part]:
    """Geoms of a body, those of one colour joined: fewer objects for a browser to draw."""
    by_colour = defaultdict(list)
    for geom in np.flatnonzero(model.geom_bodyid == body):
        by_colour[tuple(model.geom_rgba[geom].tolist())].append(_placed(model, int(geom)))
    found = []
    for (red, green, blue, alpha), shapes in by_colour.items():
        mesh: Any = trimesh.util.concatenate(shapes)
        colour = (round(255 * red), round(255 * green), round(255 * blue))
        found.append(Part(np.asarray(mesh.vertices), np.asarray(mesh.faces), colour, alpha))
    return found


def _placed(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """A geom's mesh in the frame of its body."""
    shape = _shape(model, geom)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = turn.reshape(3, 3), model.geom_pos[geom]
    shape.apply_transform(place)
    return shape


def _shape(model: mujoco.MjModel, geom: int) -> trimesh.Trimesh:
    """A geom's mesh in its own frame.

    Raises:
        ValueError: It is of a kind that the car is not made of.
    """
    kind, size = mujoco.mjtGeom(model.geom_type[geom]), model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return trimesh.creation.box(extents=2 * size)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return trimesh.creation.cylinder(radius=size[0], height=2 * size[1], sections=24)
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        ball = trimesh.creation.icosphere(subdivisions=2)
        ball.apply_scale(size)
        return ball
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        first, last = int(mesh.vertadr[0]), int(mesh.vertadr[0] + mesh.vertnum[0])
        begin, end = int(mesh.faceadr[0]), int(mesh.faceadr[0] + mesh.facenum[0])
        return trimesh.Trimesh(
            model.mesh_vert[first:last], model.mesh_face[begin:end], process=False
        )
    raise ValueError(f"geom {geom} is a {kind.name}: add its shape to viz.viewer.shapes")
