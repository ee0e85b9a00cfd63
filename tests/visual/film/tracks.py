"""Tracks of known geometry."""

import numpy as np

from buggy_rl.visual.film.track import PathLine, Track


def circle(radius=2.0, speed=1.0, seconds=4.0, name="car", **rest) -> Track:
    """To the left about (0, radius), from the origin along x; full of equal steps of 10 ms."""
    time = np.arange(0.0, seconds + 1e-9, 0.01)
    angle = speed * time / radius
    pose = np.stack([radius * np.sin(angle), radius * (1 - np.cos(angle)), angle], -1)
    velocity = np.tile([speed, 0.0, speed / radius], (len(time), 1))
    action = np.tile([0.2, 0.5], (len(time), 1))
    return Track(name, time, pose, velocity, action, **rest)


def straight(speed=1.0, seconds=4.0, name="car", y=0.0, **rest) -> Track:
    """Along x."""
    time = np.arange(0.0, seconds + 1e-9, 0.01)
    pose = np.stack([speed * time, np.full(len(time), y), np.zeros(len(time))], -1)
    velocity = np.tile([speed, 0.0, 0.0], (len(time), 1))
    return Track(name, time, pose, velocity, np.tile([0.2, 0.0], (len(time), 1)), **rest)


def on_course(closed=False, count=20) -> Track:
    """At 1 m/s along waypoints that are 0.2 m apart; waypoint k is closed at 0.2 k s."""
    track = straight()
    points = np.stack([0.2 * np.arange(count), np.zeros(count)], -1)
    following = np.floor(track.time / 0.2 + 1e-6).astype(int) + 1
    return straight(course=PathLine(points, closed), following=following)
