"""Two programs cannot command one board."""

import json
import subprocess
import sys
import time

import pytest

from buggy_rl.car import board_lock
from buggy_rl.car.clock import Clock
from buggy_rl.car.pwm_pca9685 import PCA9685
from buggy_rl.car.watchdog_link import Watchdog
from tests.car.test_watchdog import Log

HOLDER = """
import sys, time
from buggy_rl.car.board_lock import hold
hold(sys.argv[1])
print("held", flush=True)
time.sleep(60)
"""


@pytest.fixture
def other(tmp_path):
    """Another program that holds a lock; call it with the lock's file."""
    started = []

    def hold(file):
        command = [sys.executable, "-c", HOLDER, str(file)]
        started.append(subprocess.Popen(command, stdout=subprocess.PIPE))
        assert started[-1].stdout.readline() == b"held\n"
        return started[-1]

    yield hold
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


def test_a_lock_that_another_program_holds_is_refused_with_its_file(tmp_path, other):
    file = tmp_path / "board.lock"
    other(file)
    with pytest.raises(OSError, match=rf"another program commands this board .it holds {file}"):
        board_lock.hold(str(file))


def test_a_program_that_ends_lets_go(tmp_path, other):
    file = tmp_path / "board.lock"
    process = other(file)
    process.kill()
    process.wait()
    board_lock.hold(str(file))
    board_lock.release(str(file))


def test_one_program_may_open_a_board_twice(tmp_path, other):
    file = str(tmp_path / "board.lock")
    board_lock.hold(file)
    board_lock.hold(file)
    board_lock.release(file)
    with pytest.raises(AssertionError):  # it is still held here
        other(file)
    board_lock.release(file)
    other(file)


def test_two_runtimes_cannot_command_one_board(tmp_path, other):
    log = Log(tmp_path)
    first = Watchdog(log.about, Clock())
    second = (
        "import json, sys\nfrom buggy_rl.car.clock import Clock\n"
        "from buggy_rl.car.watchdog_link import Watchdog\n"
        "Watchdog(json.loads(sys.argv[1]), Clock())"
    )
    command = [sys.executable, "-c", second, json.dumps(log.about)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert "another program commands this board" in done.stderr
    assert first.close()
    assert Watchdog(log.about, Clock()).close()


def test_the_watchdog_keeps_the_lock_of_a_loop_that_was_killed(tmp_path):
    log = Log(tmp_path)
    loop = (
        "import json, os, sys, time\nfrom buggy_rl.car.clock import Clock\n"
        "from buggy_rl.car.watchdog_link import Watchdog\n"
        "Watchdog(json.loads(sys.argv[1]), Clock())\nos.kill(os.getpid(), 9)"
    )
    subprocess.run([sys.executable, "-c", loop, json.dumps(log.about)], timeout=60)
    begin = time.monotonic()
    watchdog = Watchdog(log.about, Clock())  # waits until the other one has written its last
    assert log.last() == (-1.0, 0.0)
    assert time.monotonic() - begin > 0.2
    assert watchdog.close()


def test_each_pwm_board_has_a_lock_of_its_own():
    one, same, other = (
        PCA9685.board(settings)
        for settings in ({"address": 64}, {"address": 64, "steering_trim": 0.1}, {"address": 65})
    )
    assert one == same != other
    assert "i2c-1-0x40" in one


def test_a_person_s_own_driver_is_locked_by_its_settings(tmp_path):
    from tests.car.test_watchdog import FileActuator

    assert FileActuator.board({"path": "a"}) == FileActuator.board({"path": "a"})
    assert FileActuator.board({"path": "a"}) != FileActuator.board({"path": "b"})
