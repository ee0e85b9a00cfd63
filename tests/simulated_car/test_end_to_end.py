"""The runtime and the simulated car as processes: a drive, faults in it, and its recording."""

import importlib
import json
import random
import signal
import subprocess
import time

import pytest

from buggy_rl.recordings.loading import load_recording
from buggy_rl.simulated_car.config import SimulatedCarConfig
from buggy_rl.simulated_car.launcher import (
    SimulatedCar,
    policy_section,
    simulated_config,
    start_runtime,
    write_course,
)
from buggy_rl.task.paths.making import PathConfig

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]
REPORTED = 0.001  # [s] the board logs a command so long before the watchdog at most
SLACK = 60.0  # [ms] granted beyond the rules to a machine that is busy with other tests
TIMES = 4  # injections at most until one is in time: other work adds to a time, never takes away


@pytest.fixture(scope="module", autouse=True)
def faults(request):
    """The modules of the fault campaign, by name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(request.config.rootpath / "benchmarks")
        yield lambda name: importlib.import_module(f"faults.{name}")


@pytest.fixture(scope="module")
def car():
    with SimulatedCar(SimulatedCarConfig(simulator="kinematic")) as running:
        yield running


class Driven:
    """A runtime on the car, armed again after each fault."""

    def __init__(self, car, folder, faults):
        self.car, self.folder = car, folder
        self.injection, self.missing_time = faults("injection"), faults("campaign").missing_time
        course = write_course("lap", PathConfig(), folder)
        policy = policy_section("pursuit", course, {"speed": 1.0})
        about = simulated_config(car_config(), car.address, policy, str(folder / "rec"), 60.0)
        about["pilot"] = {"kind": "scripted", "press_after": 0.2, "again": True}
        self.begin = car.now
        self.process = start_runtime(about, folder / "car.json", subprocess.DEVNULL)

    def wait_for_drive(self):
        end = time.monotonic() + 60
        while self.car.wheels(self.car.now)[0][1] <= -1.0:
            assert time.monotonic() < end, "it does not drive"
            time.sleep(0.02)
        time.sleep(0.3)
        if self.car.wheels(self.car.now)[0][1] <= -1.0:
            self.wait_for_drive()

    def cut(self, fault, chance, within):
        """Time [ms] until a fault cut the drive: the first of some below `within`, or the last."""
        for _ in range(TIMES):
            found = self.react(fault, chance).cut
            if found < within:
                break
        return found

    def react(self, fault, chance):
        self.wait_for_drive()
        target = self.injection.Target(self.car, self.process, chance)
        begin = self.injection.FAULTS[fault](target)
        time.sleep(max(0.0, begin + 0.5 - self.car.now))
        return self.reaction(begin)

    def reaction(self, begin):
        """Of the wheels to what began then."""
        return self.injection.reaction(begin, self.car.wheels(begin))

    def missing(self, end):
        """Time [s] of the readings before `end` that are in no row."""
        sent = [stamp for stamp in self.car.sent(self.begin) if stamp < end]
        return self.missing_time(self.recording, sent)

    def end(self, number=signal.SIGTERM):
        self.ended = self.car.now
        self.process.send_signal(number)
        return self.process.wait(20)

    @property
    def recording(self):
        return self.folder / "rec" / "drive_00.csv"


def car_config():
    return SimulatedCarConfig(simulator="kinematic")


@pytest.fixture
def driven(car, tmp_path, faults):
    made = Driven(car, tmp_path, faults)
    yield made
    if made.process.poll() is None:
        made.process.kill()
        made.process.wait()


def test_drive_is_cut_within_150_ms_of_faults_that_the_runtime_survives(driven):
    chance = random.Random(3)
    for fault in ("silent", "frozen", "not_a_number", "pwm_refused", "stamps_back"):
        assert driven.cut(fault, chance, 110 + SLACK) < 110 + SLACK, fault
    for fault in ("velocity_frozen", "loop_stutters"):
        assert driven.cut(fault, chance, 150 + SLACK) < 150 + SLACK, fault
    assert driven.end() == 0
    recording = load_recording(driven.recording)
    assert recording.data["pose"].isfinite().all()
    assert driven.missing(driven.ended) < 1.0


def test_a_killed_loop_leaves_neutral_wheels_and_its_recording(driven):
    driven.wait_for_drive()
    time.sleep(1.0)
    begin = driven.car.now
    driven.process.kill()
    driven.process.wait()
    time.sleep(0.3)
    # Timed in tests/car/test_own_stop.py and by benchmarks/car_faults.py: one kill tells no time.
    assert driven.reaction(begin).neutral < 300
    assert driven.missing(begin) < 1.0
    assert len(load_recording(driven.recording)) > 100


def test_rows_hold_the_command_that_acted_from_their_stamp_on(driven):
    driven.wait_for_drive()
    time.sleep(1.0)
    assert driven.end() == 0
    origin = json.loads(driven.recording.with_suffix(".json").read_text())["origin"]
    log = [(t - origin, command) for t, *command in driven.car.wheels(driven.begin)]
    wrong, compared = 0, 0
    for line in driven.recording.read_text().splitlines()[20:-2]:
        cells = line.split(",")
        stamp, command = float(cells[0]), [float(cells[7]), float(cells[8])]
        before = [entry for entry in log if entry[0] <= stamp]
        if min(abs(stamp - t) for t, _ in log) > REPORTED:
            compared += 1
            wrong += before[-1][1] != command
    assert wrong <= 0.02 * compared


def test_a_car_that_does_not_start_is_said():
    with pytest.raises(OSError, match="did not start"):
        SimulatedCar(SimulatedCarConfig(simulator="no_such_engine"))
