"""Appearance of the buggy: geoms without mass and contact, a floor and a light."""

import numpy as np

from buggy_rl.vehicle import VehicleDimensions


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
    """Floor and light; only the floor and the tyres have contact."""
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
