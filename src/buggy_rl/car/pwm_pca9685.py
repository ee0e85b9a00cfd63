"""The PWM board PCA9685 on I2C: throttle and steering as servo pulses.

Registers and the formula of the frequency are those of NXP's data sheet PCA9685, rev. 4, section 7.
"""

import time
from typing import Any, Mapping, NamedTuple, Optional

from buggy_rl.car.board_lock import hold, lock_file, release
from buggy_rl.car.interfaces import Actuator, neutral_of
from buggy_rl.car.settings import section

MODE1, LED0_ON_L, PRE_SCALE = 0x00, 0x06, 0xFE  # registers
REGISTERS_A_CHANNEL = 4  # ON_L, ON_H, OFF_L, OFF_H
SLEEP, AUTO_INCREMENT = 0x10, 0x20  # bits of MODE1
COUNTS = 4096  # of a period
WAKING = 0.0005  # [s] that the oscillator takes to start
SHORTEST, LONGEST = 1000.0, 2000.0  # [us] pulses of servo values 0 and 1


class Wiring(NamedTuple):
    """How board, speed controller and servo are connected and trimmed.

    A servo value is 0..1 for 1000..2000 us. Without trims they are the original study's: throttle
    -1..1 is 0.5..1, steering is steering / 2 + 0.5.
    """

    bus: int = 1
    """Number of the I2C bus: N of /dev/i2c-N."""
    address: int = 0x40
    """Address of the board, 64 with no address pin bridged."""
    frequency: float = 50.0
    """Frequency of the pulses [Hz]; a higher one acts sooner, where speed controller and servo take
    it."""
    oscillator: float = 25e6
    """Frequency of the board's oscillator [Hz]; off by some per cent: docs/car.md, calibration."""
    throttle_channel: int = 0
    steering_channel: int = 1
    throttle_trim: float = 0.0
    """Added to the servo value of the throttle, so that no drive is where the motor rests."""
    throttle_limit: float = 1.0
    """Largest servo value of the throttle, from 0.5."""
    throttle_direction: int = 1
    """-1 for a speed controller that drives forward below 0.5."""
    steering_trim: float = 0.0
    """Added to the servo value of the steering, so that 0 is straight ahead."""
    steering_limit: float = 0.5
    """Largest servo value of the steering away from 0.5: where the linkage ends."""
    steering_direction: int = 1
    """-1 for a servo that turns the wheels to the right above 0.5."""
    two_way: bool = False
    """Whether the speed controller brakes and reverses: throttle -1..1 is 0..1, and 0 is no drive;
    set by `car.two_way`."""
    heartbeat: str = ""
    """File of a GPIO's value, such as /sys/class/gpio/gpio216/value, that changes with each command
    written: it feeds the timer on the board's output-enable pin (docs/car.md). Empty for none."""


RANGES = {
    "bus": (0, 31),
    "address": (0x03, 0x77),
    "frequency": (40.0, 400.0),
    "oscillator": (23e6, 28e6),
    "throttle_channel": (0, 15),
    "steering_channel": (0, 15),
    "throttle_trim": (-0.1, 0.1),
    "throttle_limit": (0.5, 1.0),
    "throttle_direction": (-1, 1),
    "steering_trim": (-0.2, 0.2),
    "steering_limit": (0.05, 0.5),
    "steering_direction": (-1, 1),
}


def prescale(frequency: float, oscillator: float) -> int:
    """Register value for a frequency [Hz]: round(oscillator / (4096 frequency)) - 1."""
    return round(oscillator / (COUNTS * frequency)) - 1


def pulse_counts(servo: float, prescale: int, oscillator: float) -> int:
    """Counts for which a pulse is high: its length [us] over that of a count."""
    pulse = SHORTEST + servo * (LONGEST - SHORTEST)
    return round(1e-6 * pulse * oscillator / (prescale + 1))


def throttle_servo(throttle: float, wiring: Wiring) -> float:
    """Servo value of a throttle in [-1, 1]: 0.5 is no drive."""
    most = wiring.throttle_limit - 0.5
    if wiring.two_way:
        drive = max(-most, min(most, 0.5 * throttle))
        return _within(0.5 + wiring.throttle_direction * drive + wiring.throttle_trim)
    drive = min(0.25 * (throttle + 1), most)
    return _within(0.5 + wiring.throttle_direction * drive + wiring.throttle_trim)


def steering_servo(steering: float, wiring: Wiring) -> float:
    """Servo value of a steering in [-1, 1]: 0.5 is straight ahead."""
    turn = max(-wiring.steering_limit, min(wiring.steering_limit, 0.5 * steering))
    return _within(0.5 + wiring.steering_direction * turn + wiring.steering_trim)


def _within(servo: float) -> float:
    return max(0.0, min(1.0, servo))


class PCA9685(Actuator):
    """The board; it wakes up at neutral.

    Args:
        wiring: Of board, speed controller and servo.
        bus: An SMBus; opened, and the board locked, by default.
        running: It was woken up before and is left as it is.

    Raises:
        ValueError: A direction is 0, or both channels are the same.
        ImportError: Neither smbus2 nor smbus is installed.
        OSError: The board does not answer or does not take its frequency, there is no such GPIO, or
            another program has the board.
    """

    def __init__(
        self, wiring: Optional[Wiring] = None, bus: Any = None, running: bool = False
    ) -> None:
        self.wiring = w = wiring or Wiring()
        if not (w.throttle_direction and w.steering_direction):
            raise ValueError("actuator: throttle_direction and steering_direction must be 1 or -1")
        if w.throttle_channel == w.steering_channel:
            raise ValueError(
                f"actuator: throttle and steering are both channel {w.steering_channel}"
            )
        self.at_rest = neutral_of(w.two_way)
        self._prescale = prescale(w.frequency, w.oscillator)
        self._lock = lock_of(w) if bus is None else ""
        if self._lock:
            hold(self._lock)
        self._bus: Any = _opened(w.bus) if bus is None else bus
        self._heartbeat = open(w.heartbeat, "w") if w.heartbeat else None  # noqa: SIM115
        self._beat = False
        if not running:
            self._start()

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> "PCA9685":
        """Makes a board from settings: the fields of `Wiring`."""
        return cls(section(Wiring, settings, "actuator", RANGES))

    @classmethod
    def board(cls, settings: Mapping[str, Any]) -> str:
        return lock_of(section(Wiring, settings, "actuator", RANGES))

    @classmethod
    def second(cls, settings: Mapping[str, Any]) -> "PCA9685":
        # Without the heartbeat: the timer on the outputs is for the watchdog alone.
        wiring = section(Wiring, settings, "actuator", RANGES)
        return cls(wiring._replace(heartbeat=""), running=True)

    def write(self, throttle: float, steering: float) -> None:
        if not (-1 <= throttle <= 1 and -1 <= steering <= 1):  # NaN too
            raise ValueError(f"actuator: throttle {throttle}, steering {steering}: not in [-1, 1]")
        self._pulse(self.wiring.throttle_channel, throttle_servo(throttle, self.wiring))
        self._pulse(self.wiring.steering_channel, steering_servo(steering, self.wiring))
        if self._heartbeat is not None:  # only after the board has taken both
            self._beat = not self._beat
            self._heartbeat.seek(0)
            self._heartbeat.write("1" if self._beat else "0")
            self._heartbeat.flush()

    def holds(self, throttle: float, steering: float) -> bool:
        w = self.wiring
        asleep = self._read(MODE1) & SLEEP  # a board that lost its power for a moment
        return not asleep and all(
            self._read(first + 2) + 256 * self._read(first + 3) == self._counts(servo)
            for first, servo in (
                (_first(w.throttle_channel), throttle_servo(throttle, w)),
                (_first(w.steering_channel), steering_servo(steering, w)),
            )
        )

    def close(self) -> None:
        if self._bus is not None:
            self._bus.close()
            self._bus = None
            release(self._lock)
        if self._heartbeat is not None:
            self._heartbeat.close()
            self._heartbeat = None

    def _start(self) -> None:
        """Sets the frequency, which the board takes only asleep, and neutral; wakes it up."""
        w = self.wiring
        self._register(MODE1, SLEEP | AUTO_INCREMENT)
        self._register(PRE_SCALE, self._prescale)
        read = self._read(PRE_SCALE)
        if read != self._prescale:
            raise OSError(
                f"the board at I2C address {w.address:#x} has prescale {read} where "
                f"{self._prescale} was written: is it a PCA9685?"
            )
        self.neutral()
        self._register(MODE1, AUTO_INCREMENT)
        time.sleep(WAKING)

    def _pulse(self, channel: int, servo: float) -> None:
        """High from count 0 to the count where the pulse ends."""
        off, first = self._counts(servo), _first(channel)
        if self._bus is None:
            raise OSError("the PWM board is closed")
        self._bus.write_i2c_block_data(self.wiring.address, first, [0, 0, off & 0xFF, off >> 8])

    def _counts(self, servo: float) -> int:
        return pulse_counts(servo, self._prescale, self.wiring.oscillator)

    def _read(self, register: int) -> int:
        return self._bus.read_byte_data(self.wiring.address, register)

    def _register(self, register: int, value: int) -> None:
        self._bus.write_byte_data(self.wiring.address, register, value)


def lock_of(wiring: Wiring) -> str:
    """The file that is locked by who commands this board."""
    return lock_file(f"i2c-{wiring.bus}-{wiring.address:#x}")


def _first(channel: int) -> int:
    """The first register of a channel."""
    return LED0_ON_L + REGISTERS_A_CHANNEL * channel


def _opened(bus: int) -> Any:
    try:
        from smbus2 import SMBus  # pyright: ignore[reportMissingImports]
    except ImportError:
        try:
            from smbus import SMBus  # pyright: ignore[reportMissingImports]
        except ImportError:
            raise ImportError(
                "actuator.kind='pca9685' needs smbus2: pip install smbus2, or apt install "
                "python3-smbus"
            ) from None
    return SMBus(bus)
