"""What the drives never showed, which effects that hides, and what to drive to decide."""

from collections.abc import Sequence

import torch
from torch import Tensor

from buggy_rl import keys
from buggy_rl.diagnosis.fit import Fitted
from buggy_rl.diagnosis.library import Library
from buggy_rl.diagnosis.manoeuvres import MANOEUVRES, Manoeuvre
from buggy_rl.diagnosis.rollouts import Player, explained, reading
from buggy_rl.diagnosis.stretches import Stretches
from buggy_rl.evaluation import WARM_UP
from buggy_rl.vehicle import wrap_angle

SHOWN = 0.03  # share of the time that counts as having been driven
HEADINGS = 8


def weak(cut: Stretches) -> list[str]:
    """What was never, or hardly, driven, and what that hides; in plain words."""
    rows = slice(WARM_UP, None)
    vx, yaw_rate = cut.smooth_velocity[:, rows, 0], cut.smooth_velocity[:, rows, 2]
    throttle, steering = cut.action[:, rows].unbind(-1)
    drive, lateral = (throttle + 1) / 2, (vx * yaw_rate).abs()
    yaw = wrap_angle(cut.smooth_pose[:, rows, 2])
    heading = ((yaw + torch.pi) / (2 * torch.pi) * HEADINGS).long().clamp(0, HEADINGS - 1)
    seen = torch.bincount(heading.flatten(), minlength=HEADINGS) / heading.numel()
    checks = (
        ("more than 0.6 of full drive", drive > 0.6, "motor_power_limit, top_speed"),
        ("above 2 m/s", vx > 2.0, "aerodynamic_drag, top_speed"),
        ("below 1 m/s", (vx < 1.0) & (vx > 0.1), "rolling_resistance, throttle_deadband"),
        (
            "coasting without drive",
            (drive < 0.05) & (vx > 0.5),
            "rolling_resistance, viscous_drag, aerodynamic_drag apart from the throttle's effects",
        ),
        ("hard left turns", steering > 0.6, "steering_asymmetry"),
        ("hard right turns", steering < -0.6, "steering_asymmetry"),
        ("bends near the limit of grip (5 m/s^2)", lateral > 5.0, "tire_grip, grip_balance"),
        (
            "quick steering",
            cut.action[:, WARM_UP:, 1].diff(dim=1).abs() > 0.05,
            "steering_dead_time from steering_lag, steering_rate_limit, steering_backlash",
        ),
        ("going straight", (steering.abs() < 0.1) & (vx > 0.5), "steering_offset"),
    )
    found = [
        f"{what} hardly driven: hides {hides}"
        for what, mask, hides in checks
        if float(mask.double().mean()) < SHOWN
    ]
    if int((seen > 0.02).sum()) < HEADINGS:
        found.append("not all directions driven: hides floor_slope, wind")
    if float(cut.elapsed.max()) < 30.0:
        found.append("less than 30 s at a stretch: hides battery_sag")
    return found


def deciding(
    player: Player, library: Library, first: Fitted, second: Fitted, noise: Tensor, dt: float
) -> tuple[Manoeuvre, float]:
    """The manoeuvre on which two explanations differ most.

    Both are simulated. The difference is the root mean square of what the sensor would show of
    one and of the other, in units of its noise, after the commands' clock is made equal.

    Returns:
        The manoeuvre and the difference.
    """
    shown = _shown(player, library, (first, second), dt)  # (2, M, T, 6)
    sizes = []
    for index, manoeuvre in enumerate(MANOEUVRES):
        rows = len(manoeuvre.actions(dt))
        gap = ((shown[0, index, :rows] - shown[1, index, :rows]) / noise).double()
        sizes.append(float(gap.square().mean().sqrt().nan_to_num(0.0)))
    best = max(range(len(sizes)), key=sizes.__getitem__)
    return MANOEUVRES[best], sizes[best]


@torch.no_grad()
def _shown(player: Player, library: Library, rivals: Sequence[Fitted], dt: float) -> Tensor:
    """Measured pose and velocity [E, M, T, 6] of cars at rest that drive all manoeuvres.

    A manoeuvre that is over before the longest one stands still for the rest.
    """
    actions = [manoeuvre.actions(dt) for manoeuvre in MANOEUVRES]
    longest, cars = max(map(len, actions)), len(actions) * len(rivals)
    idle = torch.tensor([-1.0, 0.0])
    padded = [torch.cat([a, idle.expand(longest - len(a), 2)]) for a in actions]
    told = torch.stack(padded).repeat(len(rivals), 1, 1)  # (E * M, T, 2)
    effects, parameters, _ = library.settings([(f.unknowns, f.place) for f in rivals])
    count = len(actions)
    each = {e: {p: v.repeat_interleave(count) for p, v in ps.items()} for e, ps in effects.items()}
    own = {name: v.repeat_interleave(count) for name, v in parameters.items()}
    env, _ = explained(player.make(cars), each, own, player.standing, player.options)
    state, rows = env.reset(), []
    for action in told.unbind(1):
        state[keys.ACTION] = action
        state = env.step(state)["next"]
        rows.append(reading(state))
    return torch.stack(rows, 1).unflatten(0, (len(rivals), count))


def suggestions(
    player: Player,
    library: Library,
    rivals: Sequence[tuple[Fitted, Fitted]],
    noise: Tensor,
    dt: float,
) -> list[str]:
    """What to drive next, one line for each undecided pair."""
    found = []
    for first, second in rivals:
        manoeuvre, size = deciding(player, library, first, second, noise, dt)
        names = " from ".join("+".join(f.causes) or "nothing" for f in (first, second))
        found.append(f"{manoeuvre.words} (tells {names}, by {size:.0f} times the noise)")
    return found
