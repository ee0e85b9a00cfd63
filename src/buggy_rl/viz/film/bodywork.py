"""The buggy as it looks: MJCF of one car with steered and rolling wheels, without any physics.

Body frame at the tracking sensor, projected on the floor: x forward, y left, z up.
"""

import math

from buggy_rl.vehicle import VehicleDimensions

TREADS = 16  # blocks about a tyre, which show that it rolls
SPOKES = 5
TYRE, RIM, SPOKE = "0.07 0.07 0.08", "0.80 0.81 0.83", "0.30 0.31 0.33"
GLASS, CARBON = "0.10 0.13 0.17", "0.13 0.13 0.14"


def car_body(name: str, dimensions: VehicleDimensions, colour: str, alpha: float = 1.0) -> str:
    """MJCF of a car on a free joint.

    Joints: NAME (free), NAME_steer_left and _right (positive left), NAME_roll_front and _rear of
    each side (positive forward).

    Args:
        name: Prefix of its parts.
        dimensions: Of the car.
        colour: Of the body, `r g b` in 0..1.
        alpha: Opacity; a ghost's is below 1.
    """
    front = dimensions.cg_to_front_axle - dimensions.sensor_to_cg
    rear = front - dimensions.wheelbase
    parts = [
        f'<body name="{name}"><freejoint name="{name}"/>',
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>',
        *_shell(name, dimensions, front, rear, colour, alpha),
    ]
    for axle, x in (("front", front), ("rear", rear)):
        for side, sign in (("left", 1), ("right", -1)):
            parts.append(_wheel(f"{name}_{{}}_{axle}_{side}", dimensions, x, sign, alpha))
    return "\n".join([*parts, "</body>"])


def car_meshes(dimensions: VehicleDimensions) -> str:
    """MJCF assets: convex hulls of the body's panels, shared by all cars."""
    half, width = dimensions.length / 2, dimensions.track_width / 2
    front = dimensions.cg_to_front_axle - dimensions.sensor_to_cg
    middle, z = front - dimensions.wheelbase / 2, dimensions.wheel_radius
    nose, tail = middle + half, middle - half
    hulls = {
        "tub": [
            *_ring(nose - 0.01, 0.18 * width, 0.5 * z, 0.9 * z),
            *_ring(front - 0.01, 0.46 * width, 0.35 * z, 1.55 * z),
            *_ring(middle - 0.02, 0.66 * width, 0.35 * z, 1.75 * z),
            *_ring(tail + 0.035, 0.5 * width, 0.5 * z, 1.7 * z),
        ],
        "cabin": [
            *_ring(front - 0.035, 0.4 * width, 1.5 * z, 1.55 * z),
            *_ring(middle + 0.005, 0.36 * width, 1.5 * z, 2.6 * z),
            *_ring(middle - 0.045, 0.34 * width, 1.5 * z, 2.55 * z),
            *_ring(tail + 0.06, 0.4 * width, 1.5 * z, 1.7 * z),
        ],
        "roof": [
            *_ring(middle + 0.002, 0.37 * width, 2.55 * z, 2.68 * z),
            *_ring(middle - 0.048, 0.35 * width, 2.5 * z, 2.63 * z),
        ],
    }
    return "\n".join(
        f'<mesh name="{name}" inertia="shell" vertex="{_numbers(points)}"/>'
        for name, points in hulls.items()
    )


def _shell(
    name: str, d: VehicleDimensions, front: float, rear: float, colour: str, alpha: float
) -> list[str]:
    half, width, z = d.length / 2, d.track_width / 2, d.wheel_radius
    middle, tail = front - d.wheelbase / 2, front - d.wheelbase / 2 - half
    body, dark, glass = (f'rgba="{c} {alpha}"' for c in (colour, CARBON, GLASS))
    wing = f'pos="{tail + 0.014:.4f} 0 {2.75 * z:.4f}" size="0.020 {0.85 * width:.4f} 0.0022"'
    parts = [
        f'<geom type="mesh" mesh="tub" {body}/>',
        f'<geom type="mesh" mesh="cabin" {glass}/>',
        f'<geom type="mesh" mesh="roof" {body}/>',
        f'<geom type="box" pos="{middle:.4f} 0 {0.45 * z:.4f}" '
        f'size="{0.86 * half:.4f} {0.5 * width:.4f} 0.003" {dark}/>',
        f'<geom type="box" pos="{middle + half:.4f} 0 {0.6 * z:.4f}" '
        f'size="0.008 {0.62 * width:.4f} 0.006" {dark}/>',
        f'<geom type="box" {wing} {body}/>',
        # The tracking camera, where pose and velocity are measured.
        f'<geom type="box" pos="0.004 0 {1.75 * z:.4f}" size="0.006 0.02 0.006" {dark}/>',
    ]
    for sign in (1, -1):
        plate, strut = sign * 0.85 * width, sign * 0.35 * width
        parts += [
            f'<geom type="box" pos="{tail + 0.014:.4f} {plate:.4f} {2.7 * z:.4f}" '
            f'size="0.023 0.0015 0.011" {dark}/>',
            f'<geom type="capsule" size="0.0025" fromto="{tail + 0.04:.4f} {strut:.4f} '
            f'{1.5 * z:.4f} {tail + 0.016:.4f} {strut:.4f} {2.7 * z:.4f}" {dark}/>',
        ]
        for x in (front, rear):  # suspension arms
            parts += [
                f'<geom type="capsule" size="0.003" fromto="{x + dx:.4f} {sign * 0.3 * width:.4f} '
                f'{0.7 * z:.4f} {x:.4f} {sign * (width - d.wheel_width / 2):.4f} {z:.4f}" {dark}/>'
                for dx in (-0.02, 0.02)
            ]
    return parts


def _wheel(label: str, d: VehicleDimensions, x: float, sign: int, alpha: float) -> str:
    """One wheel; `label` has a place for the kind of joint."""
    radius, half = d.wheel_radius, d.wheel_width / 2
    steered = "front" in label
    name = label.format("wheel")
    steer = f'<joint name="{label.format("steer")}" axis="0 0 1"/>' if steered else ""
    parts = [
        f'<body name="{name}" pos="{x:.4f} {sign * d.track_width / 2:.4f} {radius:.4f}">',
        '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>',
        f'{steer}<joint name="{label.format("roll")}" axis="0 1 0"/>',
        _disc(0.96 * radius, half, 0.0, TYRE, alpha),
        _disc(0.62 * radius, 1.04 * half, 0.0, RIM, alpha),
        _disc(0.16 * radius, 1.14 * half, 0.0, SPOKE, alpha),
    ]
    for number in range(TREADS):
        angle = 2 * math.pi * number / TREADS
        parts.append(
            _block(angle, 0.95 * radius, (0.05 * radius, half, 0.11 * radius), TYRE, alpha)
        )
    for number in range(SPOKES):
        angle = 2 * math.pi * number / SPOKES
        size = (0.2 * radius, 1.08 * half, 0.06 * radius)
        parts.append(_block(angle, 0.36 * radius, size, SPOKE, alpha))
    return "".join([*parts, "</body>"])


def _disc(radius: float, half: float, y: float, rgb: str, alpha: float) -> str:
    return (
        f'<geom type="cylinder" size="{radius:.4f} {half:.4f}" pos="0 {y:.4f} 0" '
        f'euler="1.5707963 0 0" rgba="{rgb} {alpha}"/>'
    )


def _block(angle: float, radius: float, size: tuple[float, ...], rgb: str, alpha: float) -> str:
    """A box at an angle about a wheel's axis, its x outwards."""
    x, z = radius * math.cos(angle), -radius * math.sin(angle)
    sizes = " ".join(f"{s:.4f}" for s in size)
    return (
        f'<geom type="box" size="{sizes}" pos="{x:.4f} 0 {z:.4f}" euler="0 {angle:.4f} 0" '
        f'rgba="{rgb} {alpha}"/>'
    )


def _ring(x: float, half_width: float, low: float, high: float) -> list[tuple[float, ...]]:
    """Corners of a cross-section, narrower above."""
    return [
        (x, side * half_width * (1.0 if z == low else 0.85), z)
        for side in (1, -1)
        for z in (low, high)
    ]


def _numbers(points: list[tuple[float, ...]]) -> str:
    return " ".join(f"{value:.4f}" for point in points for value in point)
