from collections.abc import Sequence

import pytest
import torch
from torch import Tensor

from buggy_rl.core import keys
from buggy_rl.core.parameters import Parameter
from buggy_rl.core.vehicle import integrate_pose
from buggy_rl.estimation.fit_result import as_simulator
from buggy_rl.estimation.least_squares import FitConfig, least_squares_fit
from buggy_rl.recordings.recording import Recording
from buggy_rl.simulators import make_engine
from buggy_rl.simulators.base import Engine
from tests.drives import toy_drive

TRUE = {"push": 4.0, "drag": 1.5, "turn": 8.0}
DECLARED = (
    Parameter("push", 2.5, 1.0, 10.0, "m/s^2", "acceleration at full throttle"),
    Parameter("drag", 2.5, 0.1, 5.0, "1/s", "what speed loses"),
    Parameter("turn", 5.0, 1.0, 20.0, "1/s", "how fast the yaw rate follows"),
    Parameter("brake", 3.0, 0.0, 10.0, "m/s^2", "never seen: it only acts in reverse"),
    Parameter("thrust", 0.0, -3.0, 3.0, "m/s^2", "adds to push"),
)


class ToyEngine(Engine):
    """The car of `toy_drive` with its numbers declared."""

    def __init__(self, batch_size=(), device="cpu", parameters=None) -> None:
        super().__init__(batch_size, device, parameters, declared=DECLARED)
        self._finish()

    def _rest_latent(self, pose: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        return {}

    def _advance(self, state, action: Tensor) -> dict[str, Tensor]:
        velocity, p = state[keys.VELOCITY], self.values
        vx, vy, yaw_rate = velocity.unbind(-1)
        throttle, steering = action.unbind(-1)
        drive = (p["push"] + p["thrust"]) * (throttle + 1) / 2
        braking = torch.where(vx < -0.5, p["brake"], 0.0)
        change = torch.stack(
            [
                drive - p["drag"] * vx + braking,
                -0.5 * yaw_rate - 5 * vy,
                p["turn"] * (steering * vx - yaw_rate),
            ],
            -1,
        )
        following = velocity + self.dt * change
        pose = integrate_pose(state[keys.POSE], velocity, following, self.dt)
        return {keys.POSE: pose, keys.VELOCITY: following}

    def _rebuilt(self, batch_size: Sequence[int]) -> "ToyEngine":
        return ToyEngine(batch_size, self.device)


def make(count: int) -> ToyEngine:
    return ToyEngine((count,))


def drives(noise: float, count: int = 3) -> list[Recording]:
    return [toy_drive(str(i), 900, i, noise) for i in range(count)]


def test_the_truth_is_found_from_a_wrong_start():
    recordings = drives(0.02)
    config = FitConfig(parameters=["push", "drag", "turn"])
    for estimate in least_squares_fit(make, recordings, config).estimates:
        truth = TRUE[estimate.parameter.name]
        assert estimate.value == pytest.approx(truth, rel=0.02)
        assert estimate.low <= estimate.value <= estimate.high
        assert not estimate.warnings


@pytest.mark.slow
@pytest.mark.parametrize("fits", [4, pytest.param(12, marks=pytest.mark.slow)])
def test_intervals_cover_the_truth_about_as_often_as_they_say(fits):
    config = FitConfig(parameters=["push", "drag", "turn"])
    covered = total = 0
    for first in range(0, 3 * fits, 3):
        recordings = [toy_drive(str(i), 900, i, 0.03) for i in range(first, first + 3)]
        for estimate in least_squares_fit(make, recordings, config).estimates:
            covered += estimate.low <= TRUE[estimate.parameter.name] <= estimate.high
            total += 1
    assert covered / total >= 0.8


def test_what_the_drives_never_exercise_is_said_to_be_undetermined():
    recordings = drives(0.02)
    estimates = least_squares_fit(
        make, recordings, FitConfig(parameters=["push", "brake"])
    ).estimates
    by_name = {e.parameter.name: e for e in estimates}
    assert "these drives do not determine it" in by_name["brake"].warnings
    assert by_name["brake"].value == pytest.approx(3.0, abs=0.1), "it stays where it was"
    assert not by_name["push"].warnings


def test_two_parameters_that_do_the_same_are_named_as_indistinguishable():
    recordings = drives(0.02)
    estimates = least_squares_fit(
        make, recordings, FitConfig(parameters=["push", "thrust", "drag"])
    ).estimates
    by_name = {e.parameter.name: e for e in estimates}
    assert "these drives cannot tell it from thrust" in by_name["push"].warnings
    assert "these drives cannot tell it from push" in by_name["thrust"].warnings
    total = by_name["push"].value + by_name["thrust"].value
    assert total == pytest.approx(4.0, rel=0.03), "their sum is well known"


def test_an_unknown_parameter_is_refused_with_what_there_is():
    recordings = drives(0.0, 1)
    with pytest.raises(KeyError, match="available: brake, drag, push"):
        least_squares_fit(make, recordings, FitConfig(parameters=["grip"]))


def test_a_simulator_that_returns_nan_is_reported():
    class Broken(ToyEngine):
        def _advance(self, state, action):
            result = super()._advance(state, action)
            return {name: value * float("nan") for name, value in result.items()}

        def _rebuilt(self, batch_size):
            return Broken(batch_size, self.device)

    recordings = drives(0.0, 1)
    with pytest.raises(FloatingPointError, match="not finite"):
        least_squares_fit(
            lambda count: Broken((count,)), recordings, FitConfig(parameters=["push"])
        )


def test_a_fit_as_a_file_holds_values_intervals_and_warnings():
    recordings = drives(0.02)
    fitted = least_squares_fit(make, recordings, FitConfig(parameters=["push", "drag"]))
    content = as_simulator("toy", fitted, {"tyres": "explicit"})
    assert content["engine"] == "toy"
    assert content["options"] == {"tyres": "explicit"}
    assert content["parameters"]["push"] == pytest.approx(4.0, rel=0.02)
    about = content["_fit"]["push"]
    assert about["low"] < 4.0 < about["high"]
    assert about["started_from"] == 2.5


def test_a_simulator_that_declares_nothing_and_a_rollout_without_instants_are_refused():
    with pytest.raises(ValueError, match="declares no parameters"):
        least_squares_fit(lambda count: make_engine("hold", count), drives(0.0, 1), FitConfig())
    with pytest.raises(ValueError, match=r"lengthen fit\.horizon"):
        least_squares_fit(make, drives(0.0, 1), FitConfig(horizon=0.05))
