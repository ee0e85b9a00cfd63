"""A shot in viser's scene: cars, floor, path, waypoints, and the camera of whoever watches."""

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser
from numpy.typing import NDArray

from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.visual.film import canvas as colours
from buggy_rl.visual.film import wheels
from buggy_rl.visual.film.camera import FIELD
from buggy_rl.visual.film.canvas import MOST_GHOSTS, RGB, pixel
from buggy_rl.visual.film.director import WAYPOINTS_AHEAD, WAYPOINTS_BEHIND
from buggy_rl.visual.film.drawing import AHEAD_WIDTH, DISC, FALL, PILLAR, TRAIL_WIDTH
from buggy_rl.visual.film.scene import NAMES, Scene
from buggy_rl.visual.film.shot import Points, Shot, ShownCar, View

# pyright: reportAttributeAccessIssue=false
# MuJoCo's compiled module has no type stubs.


BODIES = ("", *(f"_{place}_hub" for place in wheels.PLACES), *(f"_{p}" for p in wheels.PLACES))
"""Suffixes of the car's name: the car itself, hubs that steer, wheels that roll."""


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


HOST = "127.0.0.1"  # nothing outside this machine reaches what is served here
ROOM = 40.0  # [m] side of the floor
CELL = 0.5  # [m] of the floor's grid
POSTS = WAYPOINTS_AHEAD + WAYPOINTS_BEHIND
NOWHERE = np.array([0.0, 0.0, -1.0])  # [m] under the floor, where unused waypoints wait
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def make_server(label: str) -> viser.ViserServer:
    """A viser server on a free port of this machine alone."""
    with redirect_stdout(StringIO()):  # its banner; the address that users open is printed later
        server = viser.ViserServer(host=HOST, port=0, label=label, verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=False)
    return server


def address(server: viser.ViserServer) -> str:
    """Address at which a browser finds it."""
    return f"http://{HOST}:{server.get_port()}"


class Stage:
    """Shows shots to every browser that is connected.

    Args:
        server: From `make_server`.
        dimensions: Of all cars.
        ghosts: Number of translucent cars.
    """

    def __init__(
        self, server: viser.ViserServer, dimensions: VehicleDimensions, ghosts: int = 0
    ) -> None:
        self._server = server
        self.names = NAMES[: 1 + ghosts]
        _add_surroundings(server.scene)
        self._frames = {name: _add_car(server.scene, name, dimensions) for name in self.names}
        self._posts = _add_posts(server.scene)
        self._lines: dict[str, Any] = {
            "ahead": _add_line(server.scene, "ahead", colours.AHEAD, AHEAD_WIDTH),
        }
        for name, paint in zip(self.names, (colours.CAR, *colours.GHOSTS), strict=False):
            trail = f"{name}_trail"
            self._lines[trail] = _add_line(server.scene, trail, paint, TRAIL_WIDTH)
        self._drawn: dict[str, bytes] = {}

    def show(self, shot: Shot, free: Iterable[int] = ()) -> None:
        """Draws a shot, and points the cameras, except those of the clients in `free`."""
        with self._server.atomic():
            for name, car in zip(self.names, shot.cars, strict=True):
                self._place(self._frames[name], car)
                self._draw(f"{name}_trail", car.trail, 0.0016)
            self._draw("ahead", shot.ahead, 0.0008)
            self._close(shot.waypoints, shot.closed_for)
        for client in self._server.get_clients().values():
            if client.client_id not in free:
                point(client.camera, shot.view)

    def _place(self, frames: dict[str, Any], car: ShownCar) -> None:
        frames[""].position = (car.x, car.y, 0.0)
        frames[""].wxyz = turn_quaternion(2, car.yaw)
        for place, roll in zip(wheels.PLACES, car.roll, strict=True):
            if place.startswith("front"):
                frames[f"_{place}_hub"].wxyz = turn_quaternion(2, car.steering_angle)
            frames[f"_{place}"].wxyz = turn_quaternion(1, float(roll))

    def _draw(self, name: str, points: Points, height: float) -> None:
        """A line through points [K, 2]; sent only when it is another one."""
        segments = pieces(points, height)
        content = segments.tobytes()
        if self._drawn.get(name) == content:
            return
        self._drawn[name] = content
        line = self._lines[name]
        line.visible = len(segments) > 0
        if len(segments):
            line.points = segments

    def _close(self, waypoints: Points, closed_for: NDArray[Any]) -> None:
        position, scale, colour = posts(waypoints, closed_for)
        content = position.tobytes() + scale.tobytes()
        if self._drawn.get("posts") != content:
            self._drawn["posts"] = content
            self._posts.batched_positions = position
            self._posts.batched_scales = scale
            self._posts.batched_colors = colour


def turn_quaternion(axis: int, angle: float) -> tuple[float, float, float, float]:
    """Quaternion w, x, y, z of a turn by `angle` [rad] about axis 0, 1 or 2."""
    about = [0.0, 0.0, 0.0]
    about[axis] = math.sin(angle / 2)
    return math.cos(angle / 2), about[0], about[1], about[2]


def pieces(points: Points, height: float) -> NDArray[np.float32]:
    """Segments [K - 1, 2, 3] between points [K, 2], at a height [m] above the floor."""
    raised = np.column_stack([points, np.full(len(points), height)]).astype(np.float32)
    return np.stack([raised[:-1], raised[1:]], 1)


def posts(
    waypoints: Points, closed_for: NDArray[Any]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Position [P, 3], scale [P, 3] and colour [P, 3] of pillars of height 1 m.

    Open waypoints stand; one that is closed turns green and goes down. Those that are not needed
    wait under the floor.
    """
    count = min(len(waypoints), POSTS)
    closed = closed_for[:count] >= 0
    upright = np.clip(1 - closed_for[:count] / FALL, 0.0, 1.0)
    height = DISC + (PILLAR - DISC) * np.where(closed, upright, 1.0)
    position = np.tile(NOWHERE, (POSTS, 1)).astype(np.float32)
    position[:count] = np.column_stack([waypoints[:count], height / 2])
    scale = np.ones((POSTS, 3), np.float32)
    scale[:count, 2] = height
    scale[:count, :2] = np.where(closed, 2.4, 1.0)[:, None]
    colour = np.tile(np.array(pixel(colours.OPEN), np.uint8), (POSTS, 1))
    colour[:count][closed] = pixel(colours.CLOSED)
    return position, scale, colour


def eye(view: View) -> NDArray[Any]:
    """Position [3] of MuJoCo's free camera, which looks along azimuth and elevation [m]."""
    level = view.distance * math.cos(view.elevation)
    return np.array([
        view.x - level * math.cos(view.azimuth),
        view.y - level * math.sin(view.azimuth),
        view.z - view.distance * math.sin(view.elevation),
    ])  # fmt: skip


def point(camera: viser.CameraHandle, view: View) -> None:
    """Points a client's camera as a view says."""
    # Straight down, the direction of view and the vertical coincide: up is then the azimuth.
    down = math.cos(view.elevation) < 1e-3
    up = (math.cos(view.azimuth), math.sin(view.azimuth), 0.0) if down else (0.0, 0.0, 1.0)
    camera.up_direction = up
    camera.position = eye(view)
    camera.look_at = (view.x, view.y, view.z)
    camera.fov = FIELD


def _add_surroundings(scene: viser.SceneApi) -> None:
    scene.set_up_direction("+z")
    sky = np.tile(np.array(pixel(colours.SKY), np.uint8), (2, 2, 1))
    scene.set_background_image(sky)
    scene.add_box("/floor", color=pixel(colours.FLOOR), dimensions=(ROOM, ROOM, 0.01),
                  position=(0.0, 0.0, -0.008), cast_shadow=False)  # fmt: skip
    scene.add_grid("/grid", width=ROOM, height=ROOM, cell_size=CELL, section_size=2 * CELL,
                   cell_color=pixel(colours.GRID), section_color=pixel(colours.GRID),
                   position=(0.0, 0.0, -0.002))  # fmt: skip


def _add_car(
    scene: viser.SceneApi, name: str, dimensions: VehicleDimensions
) -> dict[str, viser.FrameHandle]:
    """Frames by body: the car's, hubs in it, wheels in those; with their meshes."""
    found: dict[str, viser.FrameHandle] = {}
    middles: dict[str, Any] = dict(zip(wheels.PLACES, wheels.places(dimensions), strict=True))
    for body, shapes in parts(dimensions, name).items():
        place = body.removesuffix("_hub").removeprefix("_")
        path, position = f"/{name}", (0.0, 0.0, 0.0)
        if body.endswith("_hub"):
            path, position = f"/{name}/{place}", (*middles[place], dimensions.wheel_radius)
        elif place:
            path = f"/{name}/{place}/wheel"
        found[body] = scene.add_frame(path, show_axes=False, position=position)
        for index, part in enumerate(shapes):
            opacity = None if part.alpha >= 1 else part.alpha
            scene.add_mesh_simple(f"{path}/part_{index}", part.vertices, part.faces,
                                  color=part.colour, opacity=opacity, flat_shading=True,
                                  side="double")  # fmt: skip
    assert tuple(found) == BODIES
    return found


def _add_posts(scene: viser.SceneApi) -> Any:
    import trimesh

    pillar = trimesh.creation.cylinder(radius=0.014, height=1.0, sections=16)
    position, scale, colour = posts(np.zeros((0, 2)), np.zeros(0))
    return scene.add_batched_meshes_simple(
        "/waypoints", np.asarray(pillar.vertices), np.asarray(pillar.faces),
        np.tile(UPRIGHT, (POSTS, 1)), position, batched_scales=scale, batched_colors=colour,
        lod="off", flat_shading=True,
    )  # fmt: skip


def _add_line(scene: viser.SceneApi, name: str, colour: RGB, width: float) -> Any:
    begin: Sequence[Sequence[float]] = [[0.0, 0.0], [0.01, 0.0]]
    return scene.add_line_segments(
        f"/{name}", pieces(np.array(begin), 0.001), pixel(colour), thickness=width, visible=False
    )
