"""Rollouts divided among processes: the same numbers, clear errors, nothing left behind."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from buggy_rl.diagnosis.run.maker import Maker
from buggy_rl.effects.measuring import measurable_options
from buggy_rl.effects.residual import ResidualAcceleration
from buggy_rl.effects.residual_models import ResidualNetwork
from buggy_rl.estimation.rollout import ParameterSets, Simulation
from buggy_rl.estimation.segments import cut_segments
from buggy_rl.estimation.workers import Workers
from tests.diagnosis.planted import QUIET, planted_drives
from tests.jobs.test_running import alive

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def segments():
    return cut_segments(planted_drives([{}], 1, 5.0, quality=QUIET)[0], 1.0, 1.0)


@pytest.fixture(scope="module")
def workers():
    with Workers(2, least=1) as both:
        yield both


def settings(sets, count=0):
    gain = torch.linspace(0.8, 1.2, sets)
    gain = gain.unsqueeze(1) + 0.01 * torch.arange(count) if count else gain
    mass = torch.linspace(1.5, 2.0, sets)
    offset = torch.linspace(0.0, 0.02, sets)
    return ParameterSets({"steering_gain": {"gain": gain}}, {} if count else {"mass": mass}, offset)


def mean_of(simulation, segments, value):
    """A chain of two rollouts, at module level so that a worker finds it."""
    rolled = [simulation.readings(segments, settings(sets)).mean() for sets in (1, 2)]
    return value, float(sum(rolled))


@pytest.mark.slow
def test_a_simulator_is_measured_beside_itself_as_in_turn(workers):
    make = Maker("single_track")
    assert measurable_options(make, workers.results) == measurable_options(make)


def test_chains_of_rollouts_beside_each_other_give_what_they_give_in_turn_and_are_all_told(
    segments, workers
):
    told = []
    one = Simulation(Maker("single_track"), rolled=lambda *rollout: told.append(rollout))
    tasks = [(segments, 1), (segments[torch.arange(2)], 2), (segments, 3)]
    beside = replace(one, workers=workers).apart(mean_of, tasks)
    many, few, rows = len(segments), 2, segments.pose.shape[1] - 1
    expected = [(sets * count, rows) for count in (many, few, many) for sets in (1, 2)]
    assert sorted(told) == sorted(expected)
    assert beside == one.apart(mean_of, tasks)
    assert [value for value, _ in beside] == [1, 2, 3]


def test_no_process_is_started_for_what_is_done_before_it_would_be_ready():
    with Workers(2) as both:
        rows = [(torch.ones(1),), (torch.zeros(1),)]
        assert both.results(torch.neg, rows, seconds=0.1) == [-row[0] for row in rows]
        assert both._others == []


@pytest.mark.parametrize(
    "simulator", ["single_track", pytest.param("mujoco", marks=pytest.mark.slow)]
)
def test_two_processes_give_what_one_gives_to_the_last_bit(segments, workers, simulator):
    one = Simulation(Maker(simulator))
    two = replace(one, workers=workers)
    for given in (settings(5), settings(2), settings(1)):
        if simulator == "mujoco":
            given = replace(given, parameters={})
        assert torch.equal(two.readings(segments, given), one.readings(segments, given))


def test_values_of_each_segment_start_errors_and_learned_corrections_are_divided_too(
    segments, workers
):
    effect = ResidualAcceleration(model=ResidualNetwork().eval(), strength=1.0)
    one = Simulation(Maker("single_track"), standing=(effect,))
    two = replace(one, workers=workers)
    given = settings(3, len(segments))
    error = 0.1 * torch.eye(6)
    for how in ({"settings": given}, {"start_error": error}):
        # To rounding: some processors multiply matrices of other sizes in another order.
        found, alone = (s.residuals(segments, **how) for s in (two, one))
        torch.testing.assert_close(found, alone, rtol=1e-4, atol=1e-5)


def test_more_parts_than_processes_keep_their_order(workers):
    rows = [(torch.full((1,), float(n)),) for n in range(5)]
    assert workers.results(torch.neg, rows) == [-row[0] for row in rows]


def test_small_rollouts_and_closed_workers_stay_in_this_process(segments):
    alone = Workers(4, least=10_000)
    simulation = Simulation(Maker("single_track"), workers=alone)
    assert simulation.readings(segments, settings(3)).shape[0] == 3
    alone.close()
    assert alone.results(lambda x: x, [(torch.ones(1),)] * 3)[2] == 1
    assert alone._others == []


BROKEN = """
import os
from tests.plain_env import PlainCar
class Broken(PlainCar):
    def _step(self, tensordict):
        if bool((tensordict["velocity"][:, 0] > 1.0).any()):
            raise FloatingPointError("tyre without road")
        return super()._step(tensordict)
class OnlyHere(PlainCar):
    substeps = 2
    def __init__(self, *arguments):
        if os.environ.get("HOME_OF_THE_SIMULATOR") != str(os.getpid()):
            raise OSError("licence is held by another process")
        super().__init__(*arguments)
"""


@pytest.fixture
def broken(tmp_path, monkeypatch):
    file = tmp_path / "broken.py"
    file.write_text(BROKEN)
    monkeypatch.setenv("HOME_OF_THE_SIMULATOR", str(os.getpid()))
    return file


@pytest.mark.slow
def test_a_simulators_own_error_is_raised_as_if_it_were_alone(segments, broken):
    with Workers(2, least=1) as both:
        simulation = Simulation(Maker(f"{broken}:Broken"), workers=both)
        with pytest.raises(FloatingPointError, match="tyre without road"):
            simulation.readings(segments, ParameterSets(clock_offset=torch.zeros(2)))
        assert both._others == []


@pytest.mark.slow
def test_what_only_a_worker_cannot_do_is_said_with_the_remedy(segments, broken):
    with Workers(2, least=1) as both:
        simulation = Simulation(Maker(f"{broken}:OnlyHere"), workers=both)
        with pytest.raises(ValueError, match=r"licence is held by another.*set workers=1"):
            simulation.readings(segments, ParameterSets(clock_offset=torch.zeros(2)))


@pytest.mark.slow
def test_a_worker_that_is_killed_is_an_error_with_its_signal():
    with Workers(2) as both:
        both.results(torch.neg, [(torch.ones(1),)] * 2)
        [worker] = both._others
        worker._process.kill()
        with pytest.raises(ValueError, match=r"was ended by signal 9.*workers=1"):
            both.results(torch.neg, [(torch.ones(1),)] * 2)


INTERRUPTED = """
import os, sys, time, torch
from pathlib import Path
from buggy_rl.core.config import run
from buggy_rl.estimation.workers import Workers
def main():
    with Workers(2) as both:
        both.results(torch.neg, [(torch.ones(1),)] * 2)
        Path(sys.argv[1] + ".partial").write_text(str(both._others[0]._process.pid))
        Path(sys.argv[1] + ".partial").rename(sys.argv[1])
        time.sleep(60)
run(main)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "blow",
    [
        *(pytest.param(n, marks=pytest.mark.slow) for n in (signal.SIGINT, signal.SIGTERM)),
        signal.SIGKILL,
    ],
)
def test_workers_end_with_their_parent_however_it_ends(tmp_path, blow):
    file = tmp_path / "pid"
    parent = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, str(file)],
        cwd=ROOT,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    while not file.exists():
        assert parent.poll() is None
        time.sleep(0.05)
    parent.send_signal(blow)
    assert parent.wait(20) != 0
    assert not alive(int(file.read_text()))
