"""The PWM board by its registers: pulses as a servo would measure them."""

import math
import sys

import pytest

from buggy_rl.car.pwm_pca9685 import (
    PCA9685,
    Wiring,
    prescale,
    steering_servo,
    throttle_servo,
)

COUNT = 4096


class Board:
    """The registers of a PCA9685 on a bus, with the oscillator that it really has [Hz]."""

    def __init__(self, oscillator=25e6, address=0x40):
        self.registers = bytearray(256)
        self.registers[0x00], self.registers[0xFE] = 0x11, 0x1E  # power-on values: asleep, 200 Hz
        self.oscillator, self.address, self.broken, self.closed = oscillator, address, False, False
        self.shown = []  # pulses while it was awake

    def write_byte_data(self, address, register, value):
        self._take(address)
        if register == 0xFE and not self.registers[0x00] & 0x10:
            return  # the prescale is blocked unless the board sleeps
        self.registers[register] = value
        self._show()

    def write_i2c_block_data(self, address, register, values):
        self._take(address)
        step = 1 if self.registers[0x00] & 0x20 else 0  # auto-increment
        for index, value in enumerate(values):
            self.registers[register + step * index] = value
        self._show()

    def read_byte_data(self, address, register):
        self._take(address)
        return self.registers[register]

    def close(self):
        self.closed = True

    def pulse(self, channel):
        """Length of a channel's pulse [us]; 0 asleep."""
        if self.registers[0x00] & 0x10:
            return 0.0
        on_low, on_high, off_low, off_high = self.registers[6 + 4 * channel : 10 + 4 * channel]
        width = (off_low + 256 * off_high - on_low - 256 * on_high) % COUNT
        return 1e6 * width * (self.registers[0xFE] + 1) / self.oscillator

    def frequency(self):
        return self.oscillator / (COUNT * (self.registers[0xFE] + 1))

    def _take(self, address):
        if self.broken or address != self.address:
            raise OSError(121, "Remote I/O error")

    def _show(self):
        self.shown.append((self.pulse(0), self.pulse(1)))


@pytest.fixture
def board():
    return Board()


def count_length(board):
    return 1e6 * (board.registers[0xFE] + 1) / board.oscillator  # [us]


def test_the_prescale_is_that_of_the_data_sheet():
    assert prescale(200, 25e6) == 30  # the data sheet's example: 1Eh
    assert prescale(50, 25e6) == 121
    assert prescale(60, 25e6) == 101


@pytest.mark.parametrize("frequency", [50.0, 60.0, 100.0, 333.0])
def test_the_frequency_is_within_the_prescale_s_resolution(board, frequency):
    PCA9685(Wiring(frequency=frequency), board)
    assert board.frequency() == pytest.approx(frequency, rel=0.03)


@pytest.mark.parametrize(
    ("throttle", "steering", "pulses"),
    [  # the original's map: 0.5..1 and steering / 2 + 0.5 of 1000..2000 us
        (-1.0, 0.0, (1500, 1500)),
        (0.0, 1.0, (1750, 2000)),
        (1.0, -1.0, (2000, 1000)),
        (-0.5, 0.5, (1625, 1750)),
    ],
)
@pytest.mark.parametrize("frequency", [50.0, 250.0])
def test_pulses_are_the_original_s_to_half_a_count(board, throttle, steering, pulses, frequency):
    actuator = PCA9685(Wiring(frequency=frequency), board)
    actuator.write(throttle, steering)
    shown = (board.pulse(0), board.pulse(1))
    assert shown == pytest.approx(pulses, abs=0.51 * count_length(board))


def test_the_first_pulse_that_the_board_shows_is_neutral(board):
    board.registers[6:14] = bytes([0, 0, 0xFF, 0x0F] * 2)  # left over from another program
    PCA9685(Wiring(), board)
    awake = [pulses for pulses in board.shown if any(pulses)]
    assert awake
    assert awake[0] == pytest.approx((1500, 1500), abs=5)


def test_an_oscillator_that_runs_fast_is_corrected_by_its_number():
    board = Board(oscillator=26.2e6)
    PCA9685(Wiring(), board)
    assert abs(board.pulse(0) - 1500) > 50  # 5 % short
    PCA9685(Wiring(oscillator=26.2e6), board)
    assert board.pulse(0) == pytest.approx(1500, abs=3)


def test_directions_mirror_and_trims_shift():
    wiring = Wiring(steering_direction=-1, steering_trim=0.03, throttle_direction=-1)
    assert steering_servo(1.0, wiring) == pytest.approx(0.03)
    assert steering_servo(0.0, wiring) == pytest.approx(0.53)
    assert throttle_servo(-1.0, wiring) == 0.5
    assert throttle_servo(1.0, wiring) == 0.0


def test_limits_bound_the_servo_values():
    wiring = Wiring(steering_limit=0.3, throttle_limit=0.6)
    assert steering_servo(1.0, wiring) == pytest.approx(0.8)
    assert steering_servo(-1.0, wiring) == pytest.approx(0.2)
    assert throttle_servo(1.0, wiring) == pytest.approx(0.6)
    assert throttle_servo(-1.0, wiring) == 0.5
    assert steering_servo(1.0, Wiring(steering_trim=0.2)) == 1.0  # no pulse beyond 2000 us


@pytest.mark.parametrize("command", [(math.nan, 0.0), (0.0, math.nan), (1.1, 0.0), (0.0, -2.0)])
def test_a_command_that_is_none_is_refused_and_changes_nothing(board, command):
    actuator = PCA9685(Wiring(), board)
    before = bytes(board.registers)
    with pytest.raises(ValueError, match=r"not in \[-1, 1\]"):
        actuator.write(*command)
    assert bytes(board.registers) == before


def test_a_board_that_does_not_answer_is_an_error_of_the_device(board):
    with pytest.raises(OSError, match="Remote I/O"):
        PCA9685(Wiring(address=0x41), board)
    actuator = PCA9685(Wiring(), board)
    board.broken = True
    with pytest.raises(OSError, match="Remote I/O"):
        actuator.write(0.0, 0.0)


class OtherChip(Board):
    """Something else at the address: it keeps nothing."""

    def write_byte_data(self, address, register, value):
        self._take(address)


def test_another_chip_at_the_address_is_noticed():
    with pytest.raises(OSError, match="has prescale 30 where 121 was written: is it a PCA9685"):
        PCA9685(Wiring(), OtherChip())


def test_closed_it_writes_no_more(board):
    actuator = PCA9685(Wiring(), board)
    actuator.close()
    actuator.close()
    assert board.closed
    with pytest.raises(OSError, match="closed"):
        actuator.write(0.0, 0.0)


def test_the_heartbeat_changes_with_each_command_that_the_board_took(board, tmp_path):
    line = tmp_path / "value"
    actuator = PCA9685(Wiring(heartbeat=str(line)), board)
    seen = []
    for _ in range(4):
        actuator.write(-1.0, 0.0)
        seen.append(line.read_text())
    assert seen in (["0", "1", "0", "1"], ["1", "0", "1", "0"])
    board.broken = True
    with pytest.raises(OSError, match="Remote I/O"):
        actuator.write(-1.0, 0.0)
    assert line.read_text() == seen[-1]  # the timer runs out, the board's outputs go off
    actuator.close()


def test_a_heartbeat_without_its_gpio_is_an_error(board, tmp_path):
    with pytest.raises(OSError, match="no/value"):
        PCA9685(Wiring(heartbeat=str(tmp_path / "no" / "value")), board)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"frequency": 1000.0}, r"actuator\.frequency=1000\.0: must be in \[40, 400\]"),
        ({"address": 0}, r"actuator\.address=0: must be in \[3, 119\]"),
        ({"throttle_channel": 1}, "throttle and steering are both channel 1"),
        ({"steering_direction": 0}, "must be 1 or -1"),
        ({"pin": 3}, r"actuator\.pin: unknown key; available: bus, address"),
    ],
)
def test_a_wrong_setting_is_named(settings, message):
    with pytest.raises(ValueError, match=message):
        PCA9685.from_dict(settings)


def test_without_smbus_the_error_names_the_packages(monkeypatch):
    for name in ("smbus", "smbus2"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError, match="pip install smbus2, or apt install"):
        PCA9685.from_dict({})


def test_what_it_holds_is_read_from_its_registers(board):
    actuator = PCA9685(Wiring(), board)
    actuator.write(0.2, -0.3)
    assert actuator.holds(0.2, -0.3)
    assert not actuator.holds(-1.0, 0.0)
    actuator.write(-1.0, 0.0)
    assert actuator.holds(-1.0, 0.0)
    board.registers[9] ^= 1
    assert not actuator.holds(-1.0, 0.0)


def test_a_board_that_lost_its_power_for_a_moment_holds_nothing(board):
    actuator = PCA9685(Wiring(), board)
    actuator.write(-1.0, 0.0)
    board.registers[0x00] |= 0x10  # asleep, as after power-on
    assert not actuator.holds(-1.0, 0.0)


def test_a_second_handle_leaves_a_running_board_as_it_is(board, tmp_path):
    heartbeat = tmp_path / "value"
    first = PCA9685(Wiring(heartbeat=str(heartbeat)), board)
    first.write(0.2, 0.1)
    before, beat = bytes(board.registers), heartbeat.read_text()
    second = PCA9685(Wiring(), board, running=True)
    assert bytes(board.registers) == before
    second.neutral()
    assert first.holds(-1.0, 0.0)
    assert heartbeat.read_text() == beat  # only the watchdog feeds the timer
