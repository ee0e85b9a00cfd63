"""Recordings to a fitted simulator and its table, on a car ten times the buggy's length."""

import math

import numpy as np
import pandas as pd
import pytest
import torch
import yaml

from buggy_rl.core import keys
from buggy_rl.core.config import build
from buggy_rl.estimation.fit_result import as_simulator
from buggy_rl.estimation.fit_study import StudyConfig, compared_simulators, fit_setup, load_drives
from buggy_rl.estimation.least_squares import least_squares_fit
from buggy_rl.estimation.table import held_out_segments, rollout_errors
from buggy_rl.recordings import load_recordings
from buggy_rl.simulators import make_engine

pytestmark = pytest.mark.usefixtures("without_gradients")

CAR = """
about: ten times the buggy
dimensions: {wheelbase: 1.74, mass: 1625.0}
limits: {top_speed: 32.0}
"""
TRUTH = {"drive_force": 16000.0, "rear_grip": 0.75, "left_angle": 0.52, "yaw_inertia": 700.0}
NOISE = (0.005, 0.001, 0.03, 0.03, 0.005)  # x and y [m], yaw [rad], vx, vy [m/s], yaw rate [rad/s]

LIMIT_SPEED = 5.0  # [m/s] at which 0.6 of full lock, 0.25 rad, needs 0.4 g


def driven(car: str, count: int, seconds: float = 11.0) -> list[pd.DataFrame]:
    """Drives with smooth random commands, as a tracker with noise sees them."""
    engine = make_engine("single_track", (count,), parameters=TRUTH, car=car)
    randoms = [np.random.default_rng(seed) for seed in range(count)]
    t = np.arange(0, seconds, 0.01)
    knots = np.arange(0, seconds + 1, 0.8)
    throttle, steering = (
        np.stack([np.interp(t, knots, random.uniform(*limits, len(knots))) for random in randoms])
        for limits in ((0.4, 1.0), (-0.6, 0.6))
    )
    state, rows = engine.reset(), []
    for i in range(len(t)):
        rows.append(torch.cat([state[keys.POSE], state[keys.VELOCITY]], -1).numpy())
        vx = state[keys.VELOCITY][:, 0].numpy()
        steering[:, i] *= np.minimum(1.0, (LIMIT_SPEED / np.maximum(vx, 1.0)) ** 2)  # within grip
        action = np.stack([throttle[:, i], steering[:, i]], -1)
        state[keys.ACTION] = torch.tensor(action, dtype=torch.float32)
        state = engine.step(state)["next"].exclude("reward")
    seen = np.stack(rows, 1)  # [count, rows, 6]
    return [measured(t, *of_one) for of_one in zip(seen, throttle, steering, randoms, strict=True)]


def measured(t, states, throttle, steering, random) -> pd.DataFrame:
    """What a tracker with noise writes of one drive."""
    x, y, yaw, vx, vy, rate = states.T
    p, a, u, v, r = NOISE
    noisy = {
        name: values + spread * random.standard_normal(len(t))
        for name, values, spread in zip(
            ("x", "y", "yaw", "vx", "vy", "yaw_rate"), (x, y, yaw, vx, vy, rate),
            (p, p, a, u, v, r), strict=True,
        )
    }  # fmt: skip
    return pd.DataFrame({"t": t, **noisy, "throttle": throttle, "steering": steering})


@pytest.fixture(scope="module")
def study(tmp_path_factory) -> StudyConfig:
    folder = tmp_path_factory.mktemp("ten")
    (folder / "ten.yaml").write_text(CAR)
    (folder / "drives").mkdir()
    for number, drive in enumerate(driven(str(folder / "ten.yaml"), 3)):
        drive.to_csv(folder / "drives" / f"{number}.csv")
    return build(
        StudyConfig,
        [
            f"output={folder / 'out'}",
            f"car={folder / 'ten.yaml'}",
            f"data.recordings=[{folder / 'drives'}]",
            "data.held_out=['2']",
            "data.validation=['1']",
            "fit_simulator=single_track",
            f"fit.parameters=[{','.join(TRUTH)}]",
            "fit.windows=10",
            "fit.iterations=40",
            "windows=10",
        ],
    )


@pytest.mark.slow
def test_the_checks_of_the_buggy_refuse_what_those_of_the_car_accept(study):
    (_, refusals) = load_recordings(study.data.recordings)
    assert any("exceeds top_speed 15 m/s" in str(refusal) for refusal in refusals)
    recordings, refusals = load_recordings(study.data.recordings, car=study.car)
    assert refusals == []
    assert [r.duration for r in recordings] == pytest.approx([11.0] * 3, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["single_track", "kinematic"])
def test_the_ranges_hold_the_car_only_if_it_is_named(study, name):
    with pytest.raises(ValueError, match=r"outside its range .* name the car"):
        make_engine(name, parameters={"mass": 1625.0})
    declared = make_engine(name, car=study.car).declared
    force = declared["drive_force"]
    assert force.value == pytest.approx(10.0 * 1000)  # 0.63 g, as the buggy
    assert (force.lower, force.upper) == (0.0, pytest.approx(100.0 * 1000))


def test_recordings_are_fitted_and_the_fit_beats_both_baselines(study, tmp_path):
    told = []
    drives = load_drives(study.data, told.append, study.car)
    assert all("never below 0, half drive" in line for line in told)  # a note, no refusal
    setup = fit_setup(study)
    options, parameters = setup["options"], setup["parameters"]
    found = least_squares_fit(
        lambda count: make_engine("single_track", count, parameters=parameters, **options),
        drives.training,
        study.fit,
    )
    assert found.warnings == []
    for estimate in found.estimates:
        truth = TRUTH[estimate.parameter.name]
        assert estimate.value == pytest.approx(truth, rel=0.03), estimate.parameter.name
    file = tmp_path / "fitted.yaml"
    file.write_text(yaml.safe_dump(as_simulator("single_track", found, options, parameters)))
    assert make_engine(file).vehicle().wheelbase == pytest.approx(1.74)  # needs no car's file

    test = held_out_segments(drives.held_out, study.windows)
    by_name = {c.name: c for c in compared_simulators(study, ["2"])}
    by_name["single_track, fitted"] = by_name["single_track, fitted"].__class__(
        "fitted", lambda count: make_engine(file, count)
    )
    error = {
        name: math.sqrt(rollout_errors(by_name[name], test)[1].position_mse[1.0].mean().item())
        for name in ("single_track, fitted", "kinematic bicycle", "hold last")
    }
    assert error["single_track, fitted"] < 0.05  # [m] rms over 1 s, at up to 20 m/s
    assert error["single_track, fitted"] < 0.3 * error["kinematic bicycle"]
    assert error["single_track, fitted"] < 0.3 * error["hold last"]
