"""Board, camera and physics of the simulated car."""

import socket
import threading

import pytest
import torch

from buggy_rl.car.path import load_path
from buggy_rl.car.simulated import ANSWER, WRITE, SimulatedActuator
from buggy_rl.recordings.camera import Camera, CameraConfig
from buggy_rl.simulated_car.config import SimulatedCarConfig
from buggy_rl.simulated_car.launcher import write_course
from buggy_rl.simulated_car.on_car import OnCarConfig
from buggy_rl.simulated_car.physics import LiveCamera, Physics, SimulatedBoard
from buggy_rl.task.paths.making import PathConfig, make_paths

SHARP = CameraConfig(position_noise=0, yaw_noise=0, velocity_noise=0, yaw_rate_noise=0)


class Clock:
    def __init__(self):
        self.time = 0.0

    def now(self):
        return self.time


def test_the_wheels_hold_their_last_command_as_a_pwm_board_does():
    wheels = SimulatedBoard(clock := Clock())
    assert wheels.write(0.5, 0.1)
    clock.time = 100.0
    assert wheels.acting() == (0.5, 0.1)


def test_a_failsafe_makes_neutral_after_its_time():
    wheels = SimulatedBoard(clock := Clock(), failsafe=0.1)
    wheels.write(0.5, 0.1)
    clock.time = 0.09
    assert wheels.acting() == (0.5, 0.1)
    clock.time = 0.11
    assert wheels.acting() == (-1.0, 0.0)
    assert wheels.since(0.1)[-1] == (0.11, -1.0, 0.0)


def test_a_refusing_board_takes_nothing_until_its_time():
    wheels = SimulatedBoard(clock := Clock())
    wheels.refuse(1.0)
    assert not wheels.write(0.5, 0.1)
    clock.time = 1.0
    assert wheels.write(0.5, 0.1)


def test_a_board_that_loses_writes_says_that_it_took_them():
    wheels = SimulatedBoard(clock := Clock())
    wheels.lose(1.0)
    assert wheels.write(0.5, 0.1)
    assert wheels.acting() == (-1.0, 0.0)
    clock.time = 1.0
    assert wheels.write(0.5, 0.1)
    assert wheels.acting() == (0.5, 0.1)


def test_a_board_that_hangs_answers_at_its_end_and_did_nothing():
    clock = Clock()
    clock.sleep = lambda seconds: setattr(clock, "time", clock.time + seconds)
    wheels = SimulatedBoard(clock)
    wheels.hang(1.0)
    assert not wheels.write(0.5, 0.1)
    assert clock.time == 1.0
    assert wheels.acting() == (-1.0, 0.0)


def board_that(answers, tmp_path):
    """An actuator whose board gives these answers, as functions of the request's number."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(str(tmp_path / "car"))
    listener.listen()

    def serve():
        link, _ = listener.accept()
        link.recv(64)
        for answer in answers:
            number, *command = WRITE.unpack(link.recv(64))
            for each in answer(number):
                link.send(ANSWER.pack(*each, *command))
        link.close()
        listener.close()

    threading.Thread(target=serve, daemon=True).start()
    return SimulatedActuator(str(tmp_path / "car"))


def test_a_late_answer_to_an_earlier_write_is_none(tmp_path):
    answers = [lambda number: [], lambda number: [(number - 1, 1), (number, 0)]]
    actuator = board_that(answers, tmp_path)
    with pytest.raises(socket.timeout):
        actuator.write(0.5, 0.0)
    with pytest.raises(OSError, match="does not acknowledge"):
        actuator.write(-1.0, 0.0)  # the acknowledgement is of the drive
    actuator.close()


def test_a_board_that_has_ended_is_gone(tmp_path):
    actuator = board_that([lambda number: [(number, 1)]], tmp_path)
    actuator.write(0.5, 0.0)
    for _ in range(3):
        with pytest.raises(ConnectionError):
            actuator.write(-1.0, 0.0)
        assert actuator.gone
    actuator.close()


def test_the_log_begins_with_what_acted():
    wheels = SimulatedBoard(clock := Clock())
    for k in range(1, 10):
        clock.time = float(k)
        wheels.write(0.1 * k, 0.0)
    assert [entry[0] for entry in wheels.since(6.5)] == [6.0, 7.0, 8.0, 9.0]


@pytest.mark.parametrize("latency", [0.0, 0.023, 0.1])
def test_the_live_camera_sees_what_the_recording_one_does(latency):
    config = CameraConfig(**{**vars(SHARP), "latency": latency, "lever_arm_x": 0.1, "yaw": 0.2})
    t = torch.arange(60.0)[:, None]
    pose = torch.cat([0.01 * t, 1e-4 * t**2, 0.02 * t], 1)
    velocity = torch.cat([1 + 0.01 * t, 0.02 * t, 2 + 0 * t], 1)
    whole = Camera(config, 0).measure(pose, velocity, 0.01)
    live = LiveCamera(config, 0)
    for row in range(60):
        seen = live.see(pose[row], velocity[row])
        assert seen[0] == pytest.approx(whole[0][row].tolist(), abs=1e-5)
        assert seen[1] == pytest.approx(whole[1][row].tolist(), abs=1e-5)


def test_dropped_frames_are_none():
    live = LiveCamera(CameraConfig(dropped_share=0.5), 0)
    seen = [live.see(torch.zeros(3), torch.zeros(3)) for _ in range(200)]
    assert 60 < sum(each is None for each in seen) < 140


def test_the_car_starts_where_it_is_put_and_drives_off():
    config = SimulatedCarConfig(simulator="kinematic", x=1.0, y=2.0, yaw=0.5, camera=SHARP)
    physics = Physics(config)
    assert physics.measured()[0] == pytest.approx((1.0, 2.0, 0.5))
    for _ in range(50):
        physics.step((0.5, 0.0))
    pose, velocity = physics.measured()
    assert pose[0] > 1.05
    assert velocity[0] > 0.3


def test_a_concealed_dead_time_delays_the_steering():
    def turned(faults):
        physics = Physics(SimulatedCarConfig(faults=faults, camera=SHARP))
        rates = []
        for row in range(70):
            physics.step((0.2, 1.0 if row >= 50 else 0.0))
            rates.append(physics.measured()[1][2])
        return next(row for row, rate in enumerate(rates) if rate > 0.2)

    late = turned({"steering_dead_time": {"dead_time": 0.06}})
    assert late - turned({}) == 6


@pytest.mark.parametrize("name", ["lap", "infinity", "random"])
def test_a_course_is_written_as_the_task_has_it(name, tmp_path):
    kind = {"random": "tight"}.get(name, name)
    path = load_path(str(write_course(name, PathConfig(), tmp_path)))
    made = make_paths(PathConfig(kind=kind))
    assert path.closed == bool(made.closed[0])
    points = made.points[0, : int(made.count[0])]
    assert torch.as_tensor(path.points).allclose(points, atol=1e-6)


def test_a_car_that_is_at_rest_at_another_command_is_refused(tmp_path):
    file = tmp_path / "brakes.yaml"
    file.write_text("engine: kinematic\noptions: {command: throttle_brake_reverse}\n")
    with pytest.raises(ValueError, match=r"rest at 0; .* stops by -1: set two_way=true"):
        Physics(SimulatedCarConfig(simulator=str(file)))
    with pytest.raises(ValueError, match=r"rest at -1; .* stops by 0: set two_way=false"):
        Physics(SimulatedCarConfig(simulator="kinematic", two_way=True))
    Physics(SimulatedCarConfig(simulator=str(file), two_way=True))


def test_a_real_car_takes_no_options_beside_its_file():
    with pytest.raises(ValueError, match="into that file"):
        OnCarConfig("car.json", seconds=3.0)
    assert OnCarConfig("car.json").car == "car.json"


@pytest.mark.parametrize(
    "change", [{"speed": 0.0}, {"failsafe": -1.0}, {"x": float("nan")}], ids=str
)
def test_an_impossible_car_is_refused(change):
    with pytest.raises(ValueError, match="must be"):
        SimulatedCarConfig(**change)
