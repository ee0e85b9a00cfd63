"""Effects of forces, tyres and the tracker, concealed in the reference car, found by the estimator.

The reference car computes them in its own parts, and the camera in its own; the effects act on a
black box.
"""

from functools import cache

import pytest
from tensordict import TensorDict

from buggy_rl.effects.measuring import measured_options
from buggy_rl.estimation.gauss_newton import Problem, fitted
from buggy_rl.estimation.hypothesis import Library
from buggy_rl.estimation.noise_model import noise_model
from buggy_rl.estimation.rollout import Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.policies.controllers.recording import recorded_steps
from buggy_rl.policies.controllers.room import RoomDriver
from buggy_rl.proof.cases.sizes import CAMERA
from buggy_rl.recordings import Recording
from buggy_rl.recordings.camera import Camera, CameraConfig
from buggy_rl.simulators import make_engine

CONCEALED = {  # effect -> parameter, value, share by which the estimate may be off
    "understeer": ("gradient", 0.007, 0.12),
    "cornering_stiffness": ("ratio", 0.65, 0.1),
    "dive_steer": ("angle", 0.01, 0.2),
    "steering_drag": ("per_angle", 2.5, 0.1),
    # Of each axle's own side force in the car, which is more in quick steering.
    "cornering_drag": ("coefficient", 0.03, 0.3),
    "torque_steer": ("offset", -0.008, 0.15),
    # The effect's wheels slip by the turn alone, those of this car by the drive too.
    "stiff_differential": ("coupling", 0.6, 0.5),
    "pose_scale": ("ratio", 0.9, 0.02),
    "heading_drift": ("rate", 0.02, 0.05),
}
BESIDE = ("grip_balance", "steering_gain", "yaw_damping", "viscous_drag", "one_sided_drag")


def make(count):
    return make_engine("reference", count)


@cache
def options():
    return measured_options(make)


def problem(effect, value, cars=2, steps=900):
    """Drives of a car, or by a camera, with an effect, against the car without."""
    name = CONCEALED[effect][0]
    seen = {CAMERA[effect][name]: value} if effect in CAMERA else {}
    engine = make_engine("reference", cars, faults={} if seen else {effect: {name: value}})
    motion = TensorDict.stack(list(recorded_steps(engine, RoomDriver(seed=5), steps)), 1)
    drives = [
        Recording(f"drive_{i}", Camera(CameraConfig(**seen), seed=i).recorded(each), 0.01)
        for i, each in enumerate(motion.unbind(0))
    ]
    simulation, segments = Simulation(make, options=options()), cut_segments(drives, 1.0, 1.0)
    library = Library([*CONCEALED, *BESIDE], {}, own=False)
    return Problem(simulation, segments, noise_model(simulation, segments), library)


def found(asked, effects):
    """Fits of single effects and of none, with their costs, by effect."""
    starts = [asked.library.hypothesis([e] if e else []) for e in effects]
    fits = fitted(asked, starts)
    return {e: (fit, asked.cost(fit)) for e, fit in zip(effects, fits, strict=True)}


def recovered(effect, others=()):
    name, value, share = CONCEALED[effect]
    asked = problem(effect, value)
    fits = found(asked, [effect, "", *others])
    estimate = fits[effect][0].values()[effect][name]
    assert estimate == pytest.approx(value, rel=share)
    assert fits[effect][1] < fits[""][1] - 50  # [nats]
    return fits


SLOWLY = [pytest.param(e, marks=pytest.mark.slow) for e in ("understeer", "steering_drag")]


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["heading_drift", *SLOWLY])
def test_a_concealed_effect_is_recovered(effect):
    recovered(effect)


@pytest.mark.slow
@pytest.mark.parametrize("effect", CONCEALED)
def test_a_concealed_effect_explains_more_than_any_other(effect):
    others = [e for e in (*CONCEALED, *BESIDE) if e != effect]
    fits = recovered(effect, others)
    assert fits[effect][1] < min(fits[e][1] for e in others) - 10  # [nats]
