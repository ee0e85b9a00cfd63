"""Dynamic brush tyre: LuGre bristles in cells along the contact patch.

Sources
-------
* Pacejka, Tyre and Vehicle Dynamics, chapter on the brush model: tread elements of uniform
  stiffness, parabolic pressure, friction limit that is smallest at both ends of the patch.
* Canudas de Wit, Tsiotras, Velenis, Basset, Gissinger 2003, Dynamic friction models for
  road/tire longitudinal interaction: distributed LuGre equation in which the bristle deflection
  z is carried through the patch with the rolling speed, and the friction level g(v) of Stribeck.
* Deur, Asgari, Hrovat 2004, A 3D brush-type dynamic tire friction model: the same equation for
  both directions with the norm of the sliding speed, and the turn-slip term of each element.

Distributed equation (per direction j, with sliding velocity v and place s from the entry edge):

    dz_j/dt + |R omega| dz_j/ds = v_j - |v| |y| y_j,    y_j = z_j / z_sat,j(s)

The factor |y| (norm of the relative deflections) is the shape exponent of Dahl's friction law
(Dahl 1976, Solid friction damping of mechanical vibrations) taken as two instead of one: bristles
stick longer before they slide, closer to the sharp stick-slide border of the brush model.

Relaxation lengths and the pneumatic trail follow from it. The patch has four cells; the equation
is solved with upwind differences and implicit Euler, stable for any speed and any step.
"""

import numpy as np

from buggy_rl.proof.plants.rally.arrays import Array, Arrays, limit, sum4

CELLS = 4
# Mean parabolic pressure of each quarter of the patch, relative to the mean over the patch.
PRESSURE = np.array([0.625, 1.375, 1.375, 0.625])
# Middle of each cell, in patch lengths ahead of the patch centre; entry cell first.
PLACE = np.array([0.375, 0.125, -0.125, -0.375])
# Mean of the upwind deflection ramp 1/4, 2/4, 3/4, 4/4: ties slip stiffness to bristle stiffness.
MEAN_RAMP = 0.625


def friction_level(k: Arrays, load: Array, slide: Array, grip: Array) -> Array:
    """Friction coefficient available at each wheel [N, 4].

    Stribeck fall from static to sliding friction (Canudas de Wit et al. 2003, function g of the
    relative speed) and a linear fall with load (Pacejka, chapter on the similarity method).
    load [N, 4] N; slide [N, 4] m/s speed of the patch over the floor; grip [N, 4] ratio.
    """
    sliding = k["slide_ratio"] + (1.0 - k["slide_ratio"]) * np.exp(-slide / k["stribeck_speed"])
    fall = 1.0 - k["load_fall"] * (load / k["static_load"] - 1.0)
    return np.maximum(k["grip"] * grip * sliding * limit(fall, 0.5, 1.3), 1e-3)


def advance_bristles(
    k: Arrays,
    bristle: Array,
    slip: tuple[Array, Array, Array],
    roll_speed: Array,
    level: Array,
    dt: float,
) -> Array:
    """Bristle deflections one step later, [N, 4, 2, cells], m; axis 2 is (longitudinal, lateral).

    slip = (v_x, v_y, spin): patch velocity over the floor in the wheel frame, m/s, and the turn
    rate of the patch, rad/s, each [N, 4]; roll_speed = R omega [N, 4]; level [N, 4].
    """
    forward = (roll_speed >= 0.0)[:, :, None, None]
    old = np.where(forward, bristle, bristle[..., ::-1])
    velocity = _cell_velocity(k, slip, forward[:, :, 0])
    speed = np.sqrt(
        velocity[:, :, 0] * velocity[:, :, 0] + velocity[:, :, 1] * velocity[:, :, 1] + 1e-12
    )
    saturation = level[:, :, None, None] * PRESSURE / k["bristle_stiffness"]
    # The old deflection in the factor keeps the equation linear; this is stable at any step.
    part = old / saturation
    used = np.sqrt(part[:, :, 0] * part[:, :, 0] + part[:, :, 1] * part[:, :, 1])
    flow = (np.abs(roll_speed) * (CELLS * dt / k["patch_length"]))[:, :, None]
    inverse = 1.0 / (1.0 + dt * (speed * used)[:, :, None] / saturation + flow[..., None])
    new = _upwind(old + dt * velocity, inverse, flow)
    return np.where(forward, new, new[..., ::-1])


def _cell_velocity(k: Arrays, slip: tuple[Array, Array, Array], forward: Array) -> Array:
    """Sliding velocity of each cell [N, 4, 2, cells]: the turn rate adds to the lateral part."""
    slip_x, slip_y, spin = slip
    velocity = np.empty((*slip_x.shape, 2, CELLS))
    velocity[:, :, 0] = slip_x[:, :, None]
    lever = PLACE * np.where(forward, 1.0, -1.0)
    velocity[:, :, 1] = slip_y[:, :, None] + (spin * k["patch_length"])[:, :, None] * lever
    return velocity


def _upwind(source: Array, inverse: Array, flow: Array) -> Array:
    """Solve the implicit upwind step cell by cell from the entry edge."""
    new = np.empty_like(source)
    new[..., 0] = source[..., 0] * inverse[..., 0]
    for cell in range(1, CELLS):
        new[..., cell] = (source[..., cell] + flow * new[..., cell - 1]) * inverse[..., cell]
    return new


def bristle_force(
    k: Arrays, bristle: Array, slip: tuple[Array, Array, Array], roll_speed: Array, load: Array
) -> tuple[Array, Array, Array]:
    """Forces on the car in the wheel frame (F_x, F_y), N, and aligning moment M_z, N m: [N, 4].

    Elastic part: load times bristle stiffness times deflection (normalised LuGre stiffness). The
    damping part always opposes the sliding velocity; it fades with rolling and sliding speed
    because viscous rubber losses matter only close to sticking.
    """
    elastic = load[:, :, None, None] * k["bristle_stiffness"] * bristle * (1.0 / CELLS)
    damping = load * k["bristle_damping"] / (1.0 + np.abs(roll_speed) / 0.05)
    fade_x = damping / (1.0 + (slip[0] / 0.05) * (slip[0] / 0.05))
    fade_y = damping / (1.0 + (slip[1] / 0.05) * (slip[1] / 0.05))
    force_x = -sum4(elastic[:, :, 0]) - fade_x * slip[0]
    force_y = -sum4(elastic[:, :, 1]) - fade_y * slip[1]
    # The lever of the cells is fixed to the wheel, so it does not depend on the rolling direction.
    moment = -sum4(elastic[:, :, 1] * PLACE) * k["patch_length"]
    return force_x, force_y, moment


def bristle_energy(k: Arrays, bristle: Array, load: Array) -> Array:
    """Elastic energy of all bristles of a car, J [N]."""
    stored = sum4(k["bristle_stiffness"] * bristle * bristle * (0.5 / CELLS))
    return sum4(load * (stored[:, :, 0] + stored[:, :, 1]))
