"""Time, speed and commands of a shot as HTML, for viser's panel."""

from html import escape

from buggy_rl.viz.film.colours import CAR, GHOSTS, RGB, pixel
from buggy_rl.viz.film.shot import Car, Shot

ROW = '<div style="display:flex;gap:.6em;align-items:center;margin:.25em 0">{}</div>'
SCALE = (
    '<div style="position:relative;flex:1;height:.6em;background:#8886;border-radius:3px">{}</div>'
)


def instruments(shot: Shot) -> str:
    """What the inset of a film shows: names and speeds, drive, and steering to the left."""
    cars = zip(shot.cars, (CAR, *GHOSTS), strict=False)
    names = [_name(car, colour) for car, colour in cars]
    drive = (shot.car.throttle + 1) / 2
    half = max(-1.0, min(1.0, shot.car.steering)) / 2
    rows = [
        *names,
        ROW.format(f"drive {_bar(0.0, drive)} {drive:.2f}"),
        # Positive steering, to the left, fills to the left of the middle.
        ROW.format(f"steering {_bar(0.5 - max(half, 0), 0.5 + max(-half, 0))} {2 * half:+.2f}"),
    ]
    return f'<div style="padding:.2em .9em;font-size:.85em">{"".join(rows)}</div>'


def _name(car: Car, colour: RGB) -> str:
    dot = f'<span style="color:rgb{pixel(colour)}">●</span>'
    return ROW.format(f'{dot} {escape(car.name)} <b style="flex:1;text-align:right">'
                      f"{car.speed:.2f} m/s</b>")  # fmt: skip


def _bar(low: float, high: float) -> str:
    """A scale from 0 to 1, filled between two values."""
    style = f"left:{100 * low:.1f}%;width:{100 * (high - low):.1f}%"
    filled = f'<div style="position:absolute;{style};height:100%;background:rgb{pixel(CAR)}"></div>'
    return SCALE.format(filled)
