"""A case: a car in which something is concealed, and how it is driven and measured."""

import math
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Protocol

from buggy_rl.core.car_file import BUGGY_SPEED, CarFile, CarLimits, SteeringGeometry
from buggy_rl.core.longitudinal import ONE_WAY, LongitudinalCommand
from buggy_rl.core.vehicle import VehicleDimensions
from buggy_rl.proof.cases.sizes import (
    CAMERA,
    COMMANDED_SIZES,
    RALLY_SIZES,
    SIZES,
    UNKNOWN_SIZES,
)
from buggy_rl.proof.plants.composed import Disturbance, is_composed

BUGGY = 1.0  # scale of the buggy itself, a car of 1:10
FULL_SPEED = 5.0  # [m/s] setpoint of a full speed command, of the reference car as shipped


def car_of(scale: float, command: LongitudinalCommand) -> CarFile:
    """A car of the buggy's shape and density.

    Args:
        scale: Its length over the buggy's: 2 is 1:5, 10 is full size.
        command: What its first command is.
    """
    buggy, speed = VehicleDimensions(), math.sqrt(scale)
    if command.kind == "speed":
        command = replace(command, full_speed=FULL_SPEED * speed)
    return CarFile(
        name=f"buggy_times_{scale:g}",
        about="a scaled buggy",
        dimensions={"mass": buggy.mass * scale**3, "wheelbase": buggy.wheelbase * scale},
        limits=CarLimits(top_speed=BUGGY_SPEED * speed),
        command=command,
    )


def written(car: CarFile) -> dict[str, Any]:
    """The content of the file of such a car."""
    speed = {} if car.command.full_speed is None else {"full_speed": car.command.full_speed}
    limits = {} if car.limits.top_speed is None else {"top_speed": car.limits.top_speed}
    content: dict[str, Any] = {
        "about": car.about,
        "dimensions": dict(car.dimensions),
        "limits": limits,
        "command": car.command.plain_fields | speed,
    }
    if car.drive != "rear":
        content["drive"] = car.drive
    if car.steering != SteeringGeometry():
        content["steering"] = asdict(car.steering)
    if car.sensor.ahead is not None:
        content["sensor"] = {"ahead": car.sensor.ahead}
    return content


NUISANCES = {
    "white": "the camera's own noise, white",
    "coloured": "noise of the same size whose rows go together, rho 0.9",
    "thrice": "three times the noise",
    "stamps": "commands stamped one sample off",
    "jitter": "time stamps that jitter by 1 ms",
    "dropped": "two frames in a thousand lost",
    "integrator": "the simulator integrates more coarsely",
    "parameters_3": "the simulator's parameters off by 3 %, baseline drives given",
    "parameters_10": "the simulator's parameters off by 10 %, baseline drives given",
}
DRIVING = {
    "rich": "a room driver's",
    "steady": "near-constant speed, slow bends",
    "timid": "half the throttle, two thirds of the steering",
    "wild": "no throttle eased in bends or slides: it spins",
}


COMMANDS = {
    "throttle": ONE_WAY,
    "brakes": LongitudinalCommand("throttle_brake_reverse"),
    "speed": LongitudinalCommand("speed", reverse=True),
}
"""What the first command of a case's car may be; the last two with the manoeuvring driver."""
RATES = (20, 25, 50, 100)  # [Hz] of command and recording; cars move on at 100 Hz in between


class Concealing(Protocol):
    """What asking, entering and counting need to know of a case, whatever it is made of."""

    @property
    def seed(self) -> int:
        """What it was drawn from."""
        ...

    @property
    def id(self) -> str:
        """Name of its folders; independent of what is concealed."""
        ...

    @property
    def plant(self) -> str:
        """What was driven."""
        ...

    @property
    def cluster(self) -> str:
        """Name of what it shares with other cases: the make of its car, and the simulator."""
        ...

    @property
    def concealed(self) -> dict[str, dict[str, float]]:
        """Effect -> parameter -> value."""
        ...

    @property
    def truth(self) -> tuple[str, ...]:
        """What is concealed, sorted."""
        ...

    @property
    def family(self) -> str:
        """nothing, one, two, three, or unknown."""
        ...

    @property
    def unknown(self) -> bool:
        """Whether something differs that no effect describes; that may be the simulator's form."""
        ...

    @property
    def differs_unseen(self) -> bool:
        """Whether simulator and car differ in their form, and no baseline shows how."""
        ...


@dataclass(frozen=True)
class Case:
    """Everything that decides a case; `concealed` is the answer."""

    seed: int
    plant: str
    """What is driven: reference, mujoco, commonroad, rally."""
    simulator: str
    """What is to be repaired: reference, mujoco, mujoco_fitted, single_track_fitted, learned."""
    baseline: bool = False
    """Whether drives from before the change are given."""
    concealed: dict[str, dict[str, float]] = field(default_factory=dict)
    """Effect -> parameter -> value."""
    nuisance: str = "white"
    driving: str = "rich"
    seconds: float = 45.0
    """Length of each drive."""
    drives: int = 2
    held_out: int = 1
    """Drives that are sealed, to measure by."""
    spread: float = 0.0
    """Share by which each parameter of the plant is drawn off its own, at most."""
    command: str = "throttle"
    """What the car's first command is, of `COMMANDS`; others than a throttle on the reference."""
    rate: int = 100
    """Rate at which it is commanded and recorded [Hz], of `RATES`."""
    scale: float = BUGGY
    """Length of a reference car over the buggy's; its speeds and times go with the root."""
    salt: str = ""
    """What the numbers of its car, and of its nuisance, depend on beside the seed; drawn with a
    secret, and empty where the seed alone decides."""

    def __post_init__(self) -> None:
        known = {*SIZES, *UNKNOWN_SIZES, *COMMANDED_SIZES, *RALLY_SIZES}
        for what, name, names in (
            ("nuisance", self.nuisance, NUISANCES),
            ("driving", self.driving, DRIVING),
            ("command", self.command, COMMANDS),
            *(("effect", effect, known) for effect in self.concealed),
        ):
            if name not in names and not (what == "effect" and is_composed(name)):
                raise ValueError(f"no {what} {name!r}; available: {', '.join(sorted(names))}")
        if self.rate not in RATES:
            raise ValueError(f"rate is {self.rate}: must be one of {', '.join(map(str, RATES))}")
        if self.rate != RATES[-1] and self.simulator == "learned":
            raise ValueError(f"rate is {self.rate}: learned models are prepared at 100 Hz")
        if self.scale != BUGGY and {self.plant, self.simulator} != {"reference"}:
            raise ValueError(f"scale is {self.scale:g}: only the reference car has another size")

    @property
    def id(self) -> str:
        """Name of its folders; independent of what is concealed."""
        return f"{self.seed:07d}"

    @property
    def key(self) -> str:
        """What all is drawn from that is no field of its own."""
        return f"{self.salt}{self.seed}"

    @property
    def own_car(self) -> bool:
        """Whether the numbers of its car are no other case's: simulators are fitted to it alone."""
        return bool(self.spread) or self.plant == "rally"

    @property
    def truth(self) -> tuple[str, ...]:
        """What is concealed, sorted."""
        return tuple(sorted(self.concealed))

    @property
    def family(self) -> str:
        """nothing, one, two, three, or unknown where the textbook has no name for it."""
        if any(self._is_unknown(e) or is_composed(e) for e in self.concealed):
            return "unknown"
        return ("nothing", "one", "two", "three")[len(self.concealed)]

    @property
    def own_make(self) -> bool:
        """Whether the simulator is of the car's make."""
        return self.plant == self.simulator

    @property
    def differs_unseen(self) -> bool:
        """Whether the simulator is of another make, and no baseline shows how they differ."""
        return not self.own_make and not self.baseline

    @property
    def unknown(self) -> bool:
        """Whether something differs that no effect describes; that may be the simulator's form."""
        return self.family == "unknown" or (not self.concealed and self.differs_unseen)

    def _is_unknown(self, effect: str) -> bool:
        """Whether no effect describes it: a drag brake is known of a car whose command has one."""
        named = self.command != "throttle" and effect in COMMANDED_SIZES
        return (effect in UNKNOWN_SIZES and not named) or effect in RALLY_SIZES

    @property
    def every(self) -> int:
        """Control periods between two of its commands."""
        return RATES[-1] // self.rate

    @property
    def longitudinal(self) -> LongitudinalCommand:
        """What the car's first command is."""
        return COMMANDS[self.command]

    @property
    def car(self) -> CarFile:
        """The car, as its file says it."""
        return car_of(self.scale, self.longitudinal)

    @property
    def cluster(self) -> str:
        """Plant and simulator, whose makes other cases have too."""
        return f"{self.plant} -> {self.simulator}"

    @property
    def pairing(self) -> str:
        """Plant and simulator, in words."""
        return f"{self.plant} -> {self.simulator}" + (", baseline" if self.baseline else "")

    @property
    def faults(self) -> dict[str, dict[str, float]]:
        """What is concealed in the car itself."""
        return {
            e: dict(v) for e, v in self.concealed.items() if e not in CAMERA and not is_composed(e)
        }

    @property
    def disturbances(self) -> list[Disturbance]:
        """What is concealed beside that, at rest."""
        return [Disturbance(e, v) for e, v in self.concealed.items() if is_composed(e)]

    @property
    def camera(self) -> dict[str, float]:
        """What is concealed in the camera, as fields of its config."""
        return {
            CAMERA[effect][name]: value
            for effect, values in self.concealed.items()
            if effect in CAMERA
            for name, value in values.items()
        }
