"""A diagnosis whose rollouts run on a GPU beside the same one on the CPU; skipped without a GPU."""

from dataclasses import replace
from functools import cache
from importlib.util import find_spec

import pytest
import torch
from torch.testing import assert_close

from buggy_rl.api.diagnosis import Diagnosis
from buggy_rl.diagnosis.pipeline import run_diagnosis
from buggy_rl.diagnosis.preflight.simulator import check_simulator
from buggy_rl.diagnosis.run.case import Criteria
from buggy_rl.diagnosis.search.joint import joint_search
from buggy_rl.effects import EFFECTS, effect_class
from buggy_rl.estimation.baseline import correct
from buggy_rl.estimation.evidence import blocks
from buggy_rl.estimation.rollout import ParameterSets, Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.simulators import make_engine
from tests.diagnosis.conftest import SMALL
from tests.diagnosis.planted import problem_of, single_track

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU here")


@cache
def on_gpu(cars: int, device: str = "cpu"):
    """A user's own factory, whose simulator is on the GPU whatever device it is asked for."""
    return make_engine("single_track", cars, "cuda")


def test_every_effect_rolls_out_as_on_the_cpu(drives):
    segments = cut_segments(drives["nothing"], 1.0, 3.0)
    row = {name: index for index, name in enumerate(EFFECTS)}
    effects = {}
    for name in EFFECTS:
        effects[name] = {
            p.name: torch.full((len(row),), p.value) for p in effect_class(name).declared
        }
        for p in effect_class(name).declared:
            effects[name][p.name][row[name]] = p.value + p.probe
    settings = ParameterSets(effects, clock_offset=torch.linspace(-0.02, 0.01, len(row)))
    error = 0.01 * torch.ones(len(row), 6)
    found = Simulation(on_gpu).residuals(segments, settings, error)
    expected = Simulation(single_track).residuals(segments, settings, error)
    assert found.device.type == "cpu"
    assert_close(found, expected, atol=2e-3, rtol=1e-3)


def test_a_search_there_comes_to_the_same(drives):
    def searched(make):
        problem = problem_of(drives["two"], make=make)
        return joint_search(problem, Criteria(blocks(problem.segments)))

    found, expected = searched(on_gpu), searched(single_track)
    best, right = found.weighed[0], expected.weighed[0]
    assert best.candidate.key == right.candidate.key == ("steering_gain", "viscous_drag")
    assert_close(best.candidate.fit.vector, right.candidate.fit.vector, atol=0.01, rtol=0.0)
    assert best.evidence.log_evidence == pytest.approx(right.evidence.log_evidence, abs=0.5)


@cache
def mujoco(cars: int):
    return make_engine("mujoco", cars)


@cache
def mujoco_on_gpu(cars: int):
    return make_engine("mujoco", cars, "cuda", backend="warp")


@pytest.mark.skipif(not find_spec("mujoco_warp"), reason="mujoco-warp is not installed")
def test_mujoco_warp_is_accepted_and_rolls_out_as_mujoco(drives):
    assert check_simulator(mujoco_on_gpu, "mujoco") == check_simulator(mujoco, "mujoco")
    segments = cut_segments(drives["nothing"], 1.0, 3.0)
    settings = ParameterSets({"steering_gain": {"gain": torch.tensor([1.0, 0.9])}})
    found = Simulation(mujoco_on_gpu).residuals(segments, settings)
    assert_close(found, Simulation(mujoco).residuals(segments, settings), atol=5e-3, rtol=1e-3)


def test_a_standing_error_is_corrected_there(long_drives):
    segments = cut_segments(long_drives["weak"], 1.0, 1.0)
    found, expected = (correct(Simulation(make), segments) for make in (on_gpu, single_track))
    assert found.after < found.before
    assert found.after == pytest.approx(expected.after, rel=0.02)
    assert (found.effect is None) == (expected.effect is None)


def test_a_whole_diagnosis_there_gives_the_same_answer(long_drives, tmp_path):
    def asked(factory):
        done = run_diagnosis(replace(SMALL, simulator=factory), long_drives["weak"])
        page = Diagnosis(SMALL, done).report(tmp_path / f"{factory.__name__}.html")
        assert page.stat().st_size > 100_000  # figures and film, too
        return done

    def on_cpu(cars: int, device: str):
        return single_track(cars)

    found, expected = asked(on_gpu.__wrapped__), asked(on_cpu)
    assert found.answer.verdict == expected.answer.verdict == "missing_physics"
    [effect], [right] = found.answer.effects, expected.answer.effects
    assert effect.name == right.name == "throttle_gain"
    value, known = (e.parameters["gain"].value for e in (effect, right))
    assert value == pytest.approx(known, abs=0.002)
    assert effect.confidence == pytest.approx(right.confidence, abs=0.02)
