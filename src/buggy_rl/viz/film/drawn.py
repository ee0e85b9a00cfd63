"""Frames drawn from above, without OpenGL."""

from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from buggy_rl.vehicle import VehicleDimensions
from buggy_rl.viz.film.cameras import FIELD, View
from buggy_rl.viz.film.colours import CAR, CLOSED, GHOST, INK, OPEN, PATH, Colour
from buggy_rl.viz.film.shot import Shot
from buggy_rl.viz.film.track import Row

FINER = 2  # pixels drawn for each that is shown, to each side: smooth edges
FLOOR, GRID = (0.88, 0.89, 0.90), (0.78, 0.79, 0.81)
TYRE = (0.12, 0.12, 0.13)


class Drawn:
    """Draws shots from above; a context manager like `Rendered`, with nothing to end.

    Args:
        alphas: Opacity of each car.
        size: Width and height of the frames [pixels].
        dimensions: Of the cars.
    """

    def __init__(
        self,
        alphas: Sequence[float],
        size: tuple[int, int],
        dimensions: VehicleDimensions | None = None,
    ) -> None:
        self.alphas, self.size = alphas, size
        self.dimensions = dimensions or VehicleDimensions()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_) -> None:
        pass

    def frame(self, shot: Shot, view: View) -> NDArray:
        """[H, W, 3] uint8; whatever the camera, it looks down on what the camera looks at."""
        width, height = (FINER * pixels for pixels in self.size)
        image = Image.new("RGB", (width, height), _bytes(FLOOR)[:3])
        pen = _Pen(image, view)
        pen.grid()
        for points, done in shot.paths():
            pen.line(points, CLOSED if done else PATH, 0.012)
            for point in points[1:]:
                pen.disc(point, CLOSED if done else OPEN, 0.022)
        for trail, colour in zip(shot.trails, (CAR, GHOST), strict=False):
            pen.line(trail, colour, 0.012, 150)
        cars = list(zip(shot.rows, (CAR, GHOST), self.alphas, strict=False))
        for row, colour, alpha in reversed(cars):
            self._car(pen, row, colour, round(255 * alpha))
        return np.asarray(image.resize(self.size, Image.Resampling.BOX))

    def _car(self, pen: "_Pen", row: Row, colour: Colour, alpha: int) -> None:
        d = self.dimensions
        front = d.cg_to_front_axle - d.sensor_to_cg
        middle = front - d.wheelbase / 2
        for x, turn in ((front, row.wheel_angle), (front - d.wheelbase, 0.0)):
            for side in (1, -1):
                place = (x, side * d.track_width / 2)
                size = (2 * d.wheel_radius, d.wheel_width)
                pen.box(row.pose, place, size, turn, TYRE, alpha)
        nose, tail, wide = middle + d.length / 2, middle - d.length / 2, 0.27 * d.track_width
        hull = [(nose, 0.4 * wide), (front, wide), (tail, wide)]
        hull += [(x, -y) for x, y in reversed(hull)]
        pen.shape(row.pose, hull, colour, alpha)
        pen.box(row.pose, (middle - 0.01, 0), (0.07, 1.3 * wide), 0.0, INK, alpha)
        pen.box(row.pose, (tail + 0.01, 0), (0.03, d.track_width), 0.0, colour, alpha)


class _Pen:
    """Draws what is given in metres."""

    def __init__(self, image: Image.Image, view: View) -> None:
        self.draw = ImageDraw.Draw(image, "RGBA")
        self.size = np.array(image.size)
        self.scale = image.height / (2 * view.distance * np.tan(np.radians(FIELD / 2)))
        self.middle = np.array(view.lookat[:2])

    def pixels(self, points: NDArray) -> list[tuple[float, float]]:
        """Places in the image of points [N, 2]."""
        places = (np.asarray(points) - self.middle) * [1, -1] * self.scale + self.size / 2
        return [(float(x), float(y)) for x, y in places]

    def grid(self) -> None:
        """A line each metre."""
        reach = self.size / 2 / self.scale
        for axis in (0, 1):
            first, last = self.middle[axis] - reach[axis], self.middle[axis] + reach[axis]
            for value in range(int(np.ceil(first)), int(np.floor(last)) + 1):
                ends = np.array([self.middle - reach, self.middle + reach])
                ends[:, axis] = value
                self.draw.line(self.pixels(ends), fill=_bytes(GRID), width=FINER)

    def line(self, points: NDArray, colour: Colour, width: float, alpha: int = 255) -> None:
        """Through points [N, 2], `width` in metres."""
        if len(points) > 1:
            pixels = max(FINER, round(width * self.scale))
            self.draw.line(self.pixels(points), _bytes(colour, alpha), pixels, joint="curve")

    def disc(self, point: NDArray, colour: Colour, radius: float) -> None:
        """About a point [2]."""
        [(x, y)], r = self.pixels(point[None]), max(radius * self.scale, 2.0 * FINER)
        self.draw.ellipse([x - r, y - r, x + r, y + r], fill=_bytes(colour))

    def shape(self, pose: Sequence[float], corners, colour: Colour, alpha: int) -> None:
        """A polygon in the frame of a car."""
        x, y, yaw = pose
        turn = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        self.draw.polygon(
            self.pixels(np.array(corners) @ turn + [x, y]), fill=_bytes(colour, alpha)
        )

    def box(self, pose, place, size, turn: float, colour: Colour, alpha: int) -> None:
        """A rectangle about a place in the frame of a car, turned to the left there."""
        corners = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)]) * size / 2
        own = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        self.shape(pose, corners @ own + np.array(place), colour, alpha)


def _bytes(colour: Colour, alpha: int = 255) -> tuple[int, ...]:
    return (*(round(255 * c) for c in colour), alpha)
